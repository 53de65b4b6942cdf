"""The 12 activities of ROS4HC: windows of 4 s each second, and the majority of the last five predictions.

A model is a scikit-learn pipeline in the format of skops, which is read without running code from the
file: a file with any type beyond those that skops itself trusts is refused, and pickle is never read.
`simulated.skops` was trained on simulated people only; `MODEL_CARD.md` beside it says what that means.
Train another one on recordings:

    python -m handover_body.processing.adl.training --data recordings/ --out my-model.skops
"""

from collections import Counter, deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import Samples, SensorReport, SignalInfo, SignalKind

Floats = NDArray[np.float64]

CLASSES: Final = (
    "Rest", "Self Propulsion", "Arm Raises", "Transfer", "Using Phone", "Conversation", "Washing Hands",
    "Eating/Drinking", "Assisted Propulsion", "Using Computer", "Changing Clothes", "Pressure Relief",
)  # fmt: skip
WINDOW_S: Final = 4.0
STEP_S: Final = 1.0
VOTES: Final = 5
WORKING_HZ: Final = 25.0
MAT_CELLS: Final = 12
DEFAULT_MODEL: Final = Path(__file__).with_name("simulated.skops")
MAX_MODEL_BYTES: Final = 20_000_000


class UnusableModel(ValueError):
    """A model file that cannot be used; the text says why and what to do."""


def features_of(acceleration: Floats, mat: Floats) -> Floats:
    """Return the figures of one window: acceleration (samples, 3) in m/s2, mat (maps, 12) in any unit."""
    g = acceleration / 9.80665
    size = np.linalg.norm(g, axis=1)
    power = np.abs(np.fft.rfft((g - g.mean(axis=0)) * np.hanning(len(g))[:, None], axis=0)) ** 2
    bands = np.array_split(power[1 : len(power)].sum(axis=1), 8)
    spectrum = np.log10([1e-6 + band.mean() for band in bands])
    total = mat.sum(axis=1)
    full = max(float(np.median(total)), 1e-9)
    shares = mat.mean(axis=0) / full
    changes = mat.std(axis=0) / full
    jerk = np.abs(np.diff(g, axis=0)).mean(axis=0)
    return np.concatenate(
        (
            g.mean(axis=0),
            np.log10(g.std(axis=0) + 1e-3),
            [np.log10(size.std() + 1e-3), size.max(), size.min()],
            np.log10(jerk + 1e-4),
            spectrum,
            shares,
            np.log10(changes + 1e-3),
            [total.min() / full, total.max() / full, np.log10(total.std() / full + 1e-3)],
        )
    )


def load_model(path: Path = DEFAULT_MODEL) -> Any:
    """Return a model; raise `UnusableModel` for a file that is missing, too large or holds code."""
    import skops.io  # noqa: PLC0415 -- an extra, and slow

    if path.suffix != ".skops":
        raise UnusableModel(f"{path} is no skops file; models are saved by skops, pickle is never read")
    if not path.is_file() or path.stat().st_size > MAX_MODEL_BYTES:
        raise UnusableModel(
            f"{path} is missing or larger than {MAX_MODEL_BYTES} bytes; train one with adl.training"
        )
    try:
        unknown = skops.io.get_untrusted_types(file=path)
    except Exception as error:  # a file of somebody else may fail in any way
        raise UnusableModel(f"{path} cannot be read: {error}; train a model with adl.training") from error
    if unknown:
        raise UnusableModel(
            f"{path} holds {', '.join(unknown)}, which is not trusted; use standard scikit-learn parts"
        )
    model = skops.io.load(path, trusted=[])
    classes = [str(name) for name in getattr(model, "classes_", ())]
    if not classes or not set(classes) <= set(CLASSES):
        raise UnusableModel(f"{path} predicts {classes}; the classes are {', '.join(CLASSES)}")
    return model


class AdlClassifier:
    """Classifies what a person does. Feed it the packets of the wrist IMU and of the mat, in any order.

    It gives no value while one of the two is missing, has a fault, or is older than the other by 2 s.
    """

    def __init__(self, model: Any, source: str) -> None:
        self._model: Final = model
        self._source: Final = source
        self._acceleration: deque[tuple[float, Floats]] = deque(maxlen=round(WINDOW_S * WORKING_HZ))
        self._mat: deque[tuple[float, Floats]] = deque(maxlen=round(WINDOW_S * WORKING_HZ))
        self._next_s = -np.inf
        self._votes: deque[str] = deque(maxlen=VOTES)

    @staticmethod
    def accepts(info: SignalInfo) -> bool:
        """Return whether a signal is one of the two."""
        if info.kind is SignalKind.ACCELERATION:
            return info.unit == "MSK" and len(info.channels) == 3 and (info.rate_hz or 0) >= WORKING_HZ
        return info.kind is SignalKind.PRESSURE_MAP and len(info.channels) == MAT_CELLS

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take a packet; return the activity once a second."""
        if not self.accepts(samples.info) or samples.quality <= 0 or not np.isfinite(samples.values).all():
            return []
        kept = self._acceleration if samples.info.kind is SignalKind.ACCELERATION else self._mat
        times_s = samples.sample_times_s()
        if kept and not 0 < times_s[0] - kept[-1][0] < 1.0:
            self._reset()
        grid = np.floor(times_s * WORKING_HZ)
        previous = np.floor(kept[-1][0] * WORKING_HZ) if kept else -np.inf
        for at_s, tick, row in zip(times_s, grid, samples.values, strict=True):
            if tick > previous:
                kept.append((float(at_s), row))
                previous = tick
        return self._predict(samples.quality)

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Forget the signals before a fault."""
        if report.fault is not None or report.has_contact is False:
            self._reset()
        return []

    def _reset(self) -> None:
        self._acceleration.clear()
        self._mat.clear()
        self._votes.clear()
        self._next_s = -np.inf

    def _predict(self, quality: float) -> Sequence[Feature]:
        if not self._acceleration or not self._mat:
            return []
        at_s = min(self._acceleration[-1][0], self._mat[-1][0])
        if at_s < self._next_s or max(self._acceleration[-1][0], self._mat[-1][0]) - at_s > 2:
            return []
        begin_s = at_s - WINDOW_S
        acceleration = np.array([row for time_s, row in self._acceleration if begin_s < time_s <= at_s])
        mat = np.array([row for time_s, row in self._mat if begin_s < time_s <= at_s])
        if len(acceleration) < 0.9 * WINDOW_S * WORKING_HZ or len(mat) < WINDOW_S * 5:
            return []
        self._next_s = at_s + STEP_S - 0.01
        figures = features_of(acceleration[-round(0.9 * WINDOW_S * WORKING_HZ) :], mat)
        shares = self._model.predict_proba(figures[None, :])[0]
        self._votes.append(str(self._model.classes_[int(np.argmax(shares))]))
        name, count = Counter(self._votes).most_common(1)[0]
        if len(self._votes) < 3:
            return []
        sure = quality * float(shares.max()) * count / len(self._votes)
        return [
            Feature(
                FeatureName.DAILY_ACTIVITY, self._source, name, at_s, sure, Status.VALID, "adl-1",
                WINDOW_S + VOTES, STEP_S, is_calibrated=False,
            )
        ]  # fmt: skip
