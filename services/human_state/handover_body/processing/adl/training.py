"""Train the classifier of activities: on simulated people, or on recordings.

    python -m handover_body.processing.adl.training --out model.skops [--data FOLDER] [--people 30]

Recordings are one CSV file per person and activity, `<person>__<activity>.csv`, 25 rows a second: three
columns of acceleration at the wrist in m/s2, then 12 of the mat. People of the test never appear in the
training. The simulated activities are guesses at what people do, from the descriptions in ROS4HC; the
accuracy on them says that the method works and nothing about real people.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from handover_body.processing.adl.classifier import CLASSES, MAT_CELLS, WINDOW_S, WORKING_HZ, features_of

Floats = NDArray[np.float64]

WINDOW: Final = round(0.9 * WINDOW_S * WORKING_HZ)

# Of each activity: direction of gravity at the wrist, frequency in Hz and size in m/s2 of its movement, the
# share of time that it moves, the shift of weight (right, forwards) with its own frequency, and the share of
# load on the mat.
MODELS: Final[
    dict[str, tuple[tuple[float, float, float], float, float, float, tuple[float, float, float], float]]
] = {
    "Rest": ((0.1, 0.2, 0.97), 0.2, 0.05, 1.0, (0.01, 0.01, 0.2), 1.0),
    "Self Propulsion": ((0.5, 0.3, 0.8), 0.9, 4.5, 1.0, (0.02, 0.15, 0.9), 1.0),
    "Arm Raises": ((0.7, 0.1, -0.6), 0.4, 3.0, 1.0, (0.02, 0.05, 0.4), 1.0),
    "Transfer": ((0.3, 0.5, 0.7), 0.6, 3.5, 0.6, (0.3, 0.3, 0.25), 0.45),
    "Using Phone": ((0.2, 0.9, 0.4), 1.5, 0.25, 0.4, (0.01, 0.02, 0.2), 1.0),
    "Conversation": ((0.2, 0.5, 0.8), 0.7, 1.0, 0.5, (0.05, 0.04, 0.3), 1.0),
    "Washing Hands": ((0.8, 0.5, 0.2), 2.8, 3.0, 0.9, (0.02, 0.12, 2.8), 0.9),
    "Eating/Drinking": ((0.6, 0.7, 0.3), 0.25, 1.6, 0.6, (0.02, 0.10, 0.25), 0.97),
    "Assisted Propulsion": ((0.1, 0.2, 0.97), 6.0, 0.6, 1.0, (0.04, 0.04, 1.5), 1.0),
    "Using Computer": ((0.0, 0.1, 1.0), 4.0, 0.35, 0.5, (0.01, 0.06, 0.1), 0.95),
    "Changing Clothes": ((0.5, 0.5, 0.1), 0.8, 4.0, 0.9, (0.2, 0.15, 0.6), 0.9),
    "Pressure Relief": ((0.6, 0.1, 0.8), 0.15, 0.4, 0.5, (0.45, 0.05, 0.12), 0.75),
}


def simulated_activity(name: str, person: int, seconds: float) -> Floats:
    """Return (samples, 15) at 25 Hz of a simulated person: acceleration, then the mat."""
    random = np.random.default_rng([person, CLASSES.index(name)])
    gravity, frequency_hz, size, share, (right, forwards, shift_hz), load = MODELS[name]
    t = np.arange(round(seconds * WORKING_HZ)) / WORKING_HZ
    direction = np.array(gravity) + random.normal(0, 0.12, 3)
    acceleration = np.tile(9.80665 * direction / np.linalg.norm(direction), (len(t), 1))
    frequency_hz *= random.uniform(0.8, 1.25)
    phase = 2 * np.pi * frequency_hz * t + np.cumsum(random.normal(0, 0.05, len(t)))
    on = np.interp(
        t, np.arange(0, seconds + 2, 2.0), random.random(len(np.arange(0, seconds + 2, 2.0))) < share
    )
    axes = random.normal(0, 1, (2, 3))
    wave = np.outer(np.sin(phase), axes[0]) + 0.4 * np.outer(np.sin(2 * phase + 1), axes[1])
    acceleration += size * random.uniform(0.7, 1.4) / 1.3 * on[:, None] * wave + random.normal(
        0, 0.06, acceleration.shape
    )
    rows, columns = np.mgrid[0:3, 0:4]
    sway = np.sin(2 * np.pi * shift_hz * random.uniform(0.8, 1.25) * t + random.uniform(0, 6))
    x = (columns.ravel() - 1.5)[None, :] - (1.5 * right * sway + random.normal(0, 0.1))[:, None]
    y = (rows.ravel() - 1.0)[None, :] + (1.5 * forwards * sway + random.normal(0, 0.1))[:, None]
    weight = random.uniform(0.7, 1.3) * (1 - (1 - load) * (0.5 + 0.5 * sway))
    mat = 1000 * weight[:, None] * np.exp(-(x**2 / 2.2 + y**2 / 1.5)) * random.uniform(0.85, 1.15, MAT_CELLS)
    return np.hstack((acceleration, np.maximum(mat + random.normal(0, 6, mat.shape), 0)))


def windows_of(recording: Floats) -> Floats:
    """Return the figures of each window of a recording, one a second."""
    first = range(0, len(recording) - WINDOW + 1, round(WORKING_HZ))
    return np.array(
        [features_of(recording[at : at + WINDOW, :3], recording[at : at + WINDOW, 3:]) for at in first]
    )


def simulated_recordings(people: int, seconds: float = 60.0) -> Iterator[tuple[str, str, Floats]]:
    """Yield person, activity and recording of simulated people."""
    for person in range(people):
        for name in CLASSES:
            yield f"simulated-{person}", name, simulated_activity(name, person, seconds)


def recordings_in(folder: Path) -> Iterator[tuple[str, str, Floats]]:
    """Yield person, activity and recording of the CSV files of a folder; raise `ValueError` with the file."""
    names = {name.lower().replace("/", "-").replace(" ", "-"): name for name in CLASSES}
    for path in sorted(folder.glob("*.csv")):
        person, _, activity = path.stem.partition("__")
        if activity.lower() not in names:
            raise ValueError(
                f"{path} must be named <person>__<activity>.csv, with one of: {', '.join(names)}"
            )
        recording = np.loadtxt(path, delimiter=",", ndmin=2)
        if recording.shape[1] != 3 + MAT_CELLS or len(recording) < WINDOW or not np.isfinite(recording).all():
            raise ValueError(
                f"{path} has the shape {recording.shape}; it needs {WINDOW} finite rows of 15 columns"
            )
        yield person, names[activity.lower()], recording


def train(recordings: list[tuple[str, str, Floats]]) -> tuple[Any, float, int]:
    """Return the model, its accuracy on people it has not seen (a fifth of them), and their windows."""
    from sklearn.linear_model import LogisticRegression  # noqa: PLC0415 -- an extra
    from sklearn.pipeline import make_pipeline  # noqa: PLC0415
    from sklearn.preprocessing import StandardScaler  # noqa: PLC0415

    people = sorted({person for person, _, _ in recordings})
    if len(people) < 5:
        raise ValueError(
            f"there are {len(people)} people; five at least, so that one can be kept for the test"
        )
    kept = set(people[::5])
    rows = [(person, name, windows_of(recording)) for person, name, recording in recordings]
    fit = [(name, figures) for person, name, figures in rows if person not in kept]
    test = [(name, figures) for person, name, figures in rows if person in kept]
    model = make_pipeline(StandardScaler(), LogisticRegression(C=0.3, max_iter=2000))
    model.fit(np.vstack([f for _, f in fit]), np.concatenate([[name] * len(f) for name, f in fit]))
    truth = np.concatenate([[name] * len(f) for name, f in test])
    return model, float(model.score(np.vstack([f for _, f in test]), truth)), len(truth)


def main(arguments: list[str] | None = None) -> int:
    """Train, print the accuracy, and save."""
    import skops.io  # noqa: PLC0415 -- an extra

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--people", type=int, default=30)
    options = parser.parse_args(arguments)
    try:
        recordings = list(
            recordings_in(options.data) if options.data else simulated_recordings(options.people)
        )
        model, accuracy, count = train(recordings)
    except ValueError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    skops.io.dump(model, options.out)
    kind = "recorded" if options.data else "simulated"
    sys.stdout.write(
        f"{options.out}: {100 * accuracy:.1f} % of {count} windows of {kind} people it has not seen\n"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
