"""Recorded hands: the recognition rate in recordings of people and in simulated work.

A recording is a CSV file with the columns pose, thumb, index, middle, ring, little; the rows of a pose are in
order of time. The recognizer gets only the first second of the fist (pose 0) and of the open hand (pose 5) of
the measured person, and where stated of each other pose; only `first_second` returns them. Its assumptions
about people come from the recordings of others.
"""

import csv
import hashlib
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from pathlib import Path

from glove_sdk_bridge.simulation.assembly import assembly
from glove_sdk_bridge.simulation.hand import SENSORS, SimulatedHand, minimum_jerk
from handover_gloves.calibration.samples import sample_of, with_sample
from handover_gloves.recognition.finger_states import finger_states
from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.gestures import M2O2P_GESTURES, Gestures
from handover_gloves.recognition.hold import HoldEvent
from handover_gloves.recognition.levels import Calibration, CalibrationFailed, calibrate
from handover_gloves.recognition.personal import PersonalRecognizer
from handover_gloves.recognition.pipeline import PipelineState, RecognitionConfig, process_frame
from handover_gloves.recognition.population import USUAL, Population, learn
from handover_gloves.recognition.registry import PERSONAL, THRESHOLDS
from handover_gloves.recognition.thresholds import FINGERS, Threshold, Thresholds

FIST, OPEN = "0", "5"
CODES = {
    "0": "22222", "1": "20222", "2": "20022", "3": "22000",
    "4": "20000", "5": "00000", "6": "02220", "8": "00222",
}  # fmt: skip
SIX = ("1", "2", "3", "4", "6", "8")
GESTURES = Gestures({**M2O2P_GESTURES, "Four fingers": "20000", "Fist": "22222", "Open hand": "00000"})
NO_COMMANDS = {"Fist", "Open hand"}
"""A hand at rest, which must not be asked for: person a's hooked index finger is a fist to the sensors."""

WINDOW_S, AROUND_CHANGE_S, CHANGES_S = 2.0, 0.5, (0.25, 0.5)
ASSEMBLY_S, ASSEMBLIES = 60.0, 3
LEARNT_FROM = frozenset({"9cc6357d789ba027", "f6c6a7574159fb0c", "1af523a85726b24b"})
"""The recordings that `USUAL` was learnt from, by their fingerprints."""

Frames = list[list[float]]


@dataclass(frozen=True)
class Recording:
    """The poses of one person, as raw frames at `hz`."""

    name: str
    poses: Mapping[str, Frames]
    hz: int = 50
    fingerprint: str = ""
    """Identifies the recording, independent of the format of the file."""

    def first_second(self, pose: str) -> Frames:
        """Return all that may be used of `pose` to calibrate for this person."""
        return list(self.poses[pose][: self.hz])

    def slower(self, factor: int) -> "Recording":
        """Return the same with only each `factor`-th frame."""
        poses = {pose: frames[::factor] for pose, frames in self.poses.items()}
        return replace(self, poses=poses, hz=self.hz // factor)


class WrongRecording(ValueError):
    """A file is no recording that can be measured; the message says why."""


def read(path: Path, hz: int = 50) -> Recording:
    """Return the recording in the file at `path`; raise `WrongRecording`."""
    poses: dict[str, Frames] = {}
    rows = csv.DictReader(path.read_bytes().decode("utf-8-sig", "replace").splitlines())
    missing = {"pose", *FINGERS} - set(rows.fieldnames or ())
    if missing:
        raise WrongRecording(f"{path.name}: no column {', '.join(sorted(missing))}")
    for number, row in enumerate(rows, start=2):
        try:
            poses.setdefault(row["pose"].strip(), []).append([float(row[finger]) for finger in FINGERS])
        except (TypeError, ValueError):
            raise WrongRecording(f"{path.name}:{number}: not five numbers") from None
    for pose, called in ((FIST, "fist"), (OPEN, "open hand")):
        if len(poses.get(pose, [])) <= hz:
            raise WrongRecording(f"{path.name}: more than a second of pose {pose} ({called}) is needed")
    first = repr([[round(value, 3) for value in frame] for frame in poses[FIST][:20]])
    return Recording(path.stem, poses, hz, hashlib.sha256(first.encode()).hexdigest()[:16])


def population_without(person: Recording, everybody: Sequence[Recording]) -> Population:
    """Return what may be assumed of people at large when `person` is measured: nothing that is theirs."""
    if person.fingerprint not in LEARNT_FROM:
        return USUAL
    return learn(_hand(other) for other in everybody if other.fingerprint != person.fingerprint)


def calibrated(person: Recording, *, samples: bool = False) -> Calibration:
    """Return the calibration by the first second of fist and open hand, and of all if `samples`."""
    calibration = calibrate(person.first_second(FIST), person.first_second(OPEN))
    for pose, code in CODES.items() if samples else ():
        if pose in person.poses:
            calibration = with_sample(
                calibration, sample_of(code, person.first_second(pose), calibration.levels)
            )
    return calibration


def config_for(
    person: Recording,
    everybody: Sequence[Recording],
    recognizer: str,
    *,
    samples: bool = False,
    in_use: frozenset[str] = frozenset(GESTURES.names),
) -> RecognitionConfig:
    """Return with what the hand of `person` is read, as in the controller, but for the population."""
    calibration = calibrated(person, samples=samples)
    config = RecognitionConfig(
        calibration.thresholds,
        GESTURES,
        calibration=calibration,
        recognizer_name=recognizer,
        in_use=in_use,
    )
    if recognizer == PERSONAL:
        population = population_without(person, everybody)
        recognizer_of_person = PersonalRecognizer(calibration, GESTURES, in_use, population)
        object.__setattr__(config, "recognizer", recognizer_of_person)
    return config


@dataclass
class Score:
    """What was measured of one person, or of several together."""

    right: Counter[str]
    frames: Counter[str]
    reached: Counter[str]
    windows: Counter[str]
    confirmed: dict[str, list[str]]
    took_s: float = 0.0
    seen: int = 0

    @classmethod
    def nothing(cls) -> "Score":
        """Return the score before anything was measured."""
        return cls(Counter(), Counter(), Counter(), Counter(), {})

    def __add__(self, other: "Score") -> "Score":
        confirmed = {
            what: [*self.confirmed.get(what, []), *other.confirmed.get(what, [])]
            for what in {**self.confirmed, **other.confirmed}
        }
        return Score(
            self.right + other.right,
            self.frames + other.frames,
            self.reached + other.reached,
            self.windows + other.windows,
            confirmed,
            self.took_s + other.took_s,
            self.seen + other.seen,
        )

    def accuracy(self, poses: Sequence[str]) -> float:
        """Return the share of frames of `poses` in which the right gesture was answered."""
        frames = sum(self.frames[pose] for pose in poses)
        return sum(self.right[pose] for pose in poses) / frames if frames else float("nan")

    def reaching(self) -> float:
        """Return the share of windows in which the right gesture was held until it counted."""
        windows = sum(self.windows.values())
        return sum(self.reached.values()) / windows if windows else float("nan")


def measure(person: Recording, config: RecognitionConfig, *, samples: bool = False) -> Score:
    """Return how well `config` read `person`; frames that calibrated are not measured."""
    score = Score.nothing()
    began = time.process_time()
    for pose, code in CODES.items():
        if pose not in person.poses:
            continue
        seen = look(person.poses[pose], config, person.hz)
        used = person.hz if samples or pose in {FIST, OPEN} else 0
        meant = GESTURES.names[code]
        score.right[pose] = sum(state.gesture == meant for state in seen[used:])
        score.frames[pose] = len(seen) - used
        score.seen += len(seen)
        for window in _windows(person.poses[pose][used:], person.hz):
            score.windows[pose] += 1
            score.reached[pose] += meant in confirmed(look(window, config, person.hz))
            score.seen += len(window)
    score.took_s = time.process_time() - began
    streams = [
        *((f"pose {pose}", person.poses[pose]) for pose in ("7", "9") if pose in person.poses),
        *(("changes", stream) for stream in changes(person)),
        *(("assembly", at_work(person, seed)) for seed in range(ASSEMBLIES)),
    ]
    for what, stream in streams:
        names = [name for name in confirmed(look(stream, config, person.hz)) if name not in NO_COMMANDS]
        score.confirmed[what] = [*score.confirmed.get(what, []), *names]
    return score


def look(frames: Sequence[Sequence[float]], config: RecognitionConfig, hz: float) -> list[PipelineState]:
    """Return what is seen in `frames`, one after the other at `hz`."""
    seen = [PipelineState()]
    for number, bend in enumerate(frames):
        seen.append(process_frame(seen[-1], Frame(number / hz, list(bend)), config))
    return seen[1:]


def confirmed(seen: Sequence[PipelineState]) -> list[str]:
    """Return the gestures that were held until they counted."""
    return [str(state.gesture) for state in seen if state.hold.last is HoldEvent.CONFIRMED]


def changes(person: Recording) -> Iterator[Frames]:
    """Yield every way from a pose to another, as quickly and as slowly as people move, and half a second of
    either around it: no pose is kept for as long as counts.
    """
    length = round(AROUND_CHANGE_S * person.hz)
    middles = {
        pose: frames[len(frames) // 2 : len(frames) // 2 + length] for pose, frames in person.poses.items()
    }
    for (first, then), change_s in product(permutations(middles, 2), CHANGES_S):
        start, end = middles[first][-1], middles[then][0]
        steps = round(change_s * person.hz)
        between = [
            [
                begin + minimum_jerk(step / steps) * (other - begin)
                for begin, other in zip(start, end, strict=True)
            ]
            for step in range(1, steps)
        ]
        yield [*middles[first], *between, *middles[then]]


def at_work(person: Recording, seed: int) -> Frames:
    """Return a minute of simulated assembly by a hand with the levels of `person`."""
    levels = calibrated(person).levels
    sensors = tuple(
        replace(sensor, bent=level.fist, straight=level.open)
        for sensor, level in zip(SENSORS, levels, strict=True)
    )
    hand = SimulatedHand(seed, rate_hz=person.hz, sensors=sensors)
    return [list(frame) for frame in assembly(hand, seed, ASSEMBLY_S)]


def half_way(person: Recording, *, whole_poses: bool) -> Score:
    """Return how well thresholds half way from fist to open hand do, frame by frame: the measure to beat."""
    fist = person.poses[FIST] if whole_poses else person.first_second(FIST)
    open_hand = person.poses[OPEN] if whole_poses else person.first_second(OPEN)
    middles = [(_middle(fist, place) + _middle(open_hand, place)) / 2 for place in range(len(FINGERS))]
    thresholds = Thresholds(tuple(Threshold(middle, middle) for middle in middles))
    score = Score.nothing()
    for pose, code in CODES.items():
        frames = person.poses.get(pose, [])[0 if whole_poses or pose not in {FIST, OPEN} else person.hz :]
        score.right[pose] = sum(finger_states(bend, thresholds) == code for bend in frames)
        score.frames[pose] = len(frames)
    return score


def contradicted(person: Recording) -> dict[str, float]:
    """Return by pose the share of frames in which a finger stands clearly on the other side than its label.

    Clearly: a finger labelled bent beyond two thirds of its span, or one labelled straight below one third.
    """
    levels = calibrated(person).levels
    recordings = {}
    for pose in SIX:
        frames = person.poses.get(pose, [])
        wrong = sum(
            any(
                (bend - level.fist) / level.span > 2 / 3
                if state == "2"
                else (bend - level.fist) / level.span < 1 / 3
                for bend, level, state in zip(frame, levels, CODES[pose], strict=True)
            )
            for frame in frames
        )
        if frames and wrong / len(frames) > 0.02:
            recordings[pose] = wrong / len(frames)
    return recordings


@dataclass(frozen=True)
class Way:
    """A way to be measured: which recognizer, with samples or not, and which gestures are in use."""

    name: str
    recognizer: str
    samples: bool = False
    in_use: frozenset[str] = frozenset(GESTURES.names)


WAYS = (
    Way("thresholds", THRESHOLDS),
    Way("personal", PERSONAL),
    Way("personal, eight gestures in use", PERSONAL, in_use=frozenset(CODES.values())),
    Way("personal, a second of each gesture", PERSONAL, samples=True),
)


def report(folder: Path, hz: int = 50) -> Iterator[str]:
    """Yield the lines of the table for all recordings in `folder`; what cannot be measured is said."""
    people: list[Recording] = []
    for path in sorted(folder.glob("*.csv")):
        try:
            person = read(path, hz)
            calibrated(person)
        except (WrongRecording, OSError) as error:
            yield f"  left out: {error}"
        except CalibrationFailed as error:
            yield f"  left out: {path.name}: {error}"
        else:
            people.append(person)
    if not people:
        yield f"  left out: there is no recording in {folder}"
        return
    yield from _table(people)
    for person in people:
        against = contradicted(person)
        for pose, share in against.items():
            yield (
                f"  {person.name}, pose {pose}: in {share:.1%} of the frames a finger stands where its label "
                "says the opposite"
            )
        if against:
            frames = sum(len(person.poses.get(pose, [])) for pose in SIX)
            lost = sum(share * len(person.poses[pose]) for pose, share in against.items())
            most = 1 - lost / frames
            yield f"  {person.name}: a classifier of finger states is right in {most:.1%} at most"


_HEAD = (
    f"  {'calibrated by one second each of fist and open hand':<52} {'frames of poses':>17} {'windows':>8}  "
    "confirmed though nothing was meant\n"
    f"  {'':<52} {'1-4,6,8':>8} {'0-6,8':>8} {'held':>8}  7, 9, changes, assembly; µs a frame"
)


def _table(people: Sequence[Recording]) -> Iterator[str]:
    yield _HEAD
    for whole, name in (
        (True, "half-way thresholds by all of both"),
        (False, "half-way thresholds"),
    ):
        scores = [half_way(person, whole_poses=whole) for person in people]
        for person, score in zip(people, scores, strict=True):
            yield _row(f"{name}: {person.name}", score)
        yield _row(f"{name}: all", sum(scores[1:], scores[0]))
    for way in WAYS:
        scores = []
        for person in people:
            config = config_for(person, people, way.recognizer, samples=way.samples, in_use=way.in_use)
            scores.append(measure(person, config, samples=way.samples))
            yield _row(f"{way.name}: {person.name}", scores[-1])
        yield _row(f"{way.name}: all", sum(scores[1:], scores[0]))
    slow = [person.slower(2) for person in people]
    scores = [measure(person, config_for(person, slow, PERSONAL)) for person in slow]
    yield _row(f"personal, every second frame ({slow[0].hz} Hz): all", sum(scores[1:], scores[0]))


def _row(name: str, score: Score) -> str:
    six, eight = score.accuracy(SIX), score.accuracy(tuple(CODES))
    row = f"  {name:<52} {six:>8.2%} {eight:>8.2%}"
    if not score.windows:
        return row
    wrong = ", ".join(
        str(len(names)) if not names else f"{len(names)} ({', '.join(sorted(set(names)))})"
        for names in score.confirmed.values()
    )
    return f"{row} {score.reaching():>8.2%}  {wrong}; {1e6 * score.took_s / score.seen:.0f}"


def _windows(frames: Frames, hz: int) -> Iterator[Frames]:
    length = round(WINDOW_S * hz)
    for start in range(0, len(frames) - length + 1, length):
        yield frames[start : start + length]


def _middle(frames: Sequence[Sequence[float]], place: int) -> float:
    values = sorted(frame[place] for frame in frames)
    return values[len(values) // 2]


def _hand(person: Recording) -> dict[str, list[list[float]]]:
    try:
        levels = calibrated(person).levels
    except CalibrationFailed:
        return {}
    return {
        code: [
            [(bend - level.fist) / level.span for bend, level in zip(frame, levels, strict=True)]
            for frame in person.poses.get(pose, [])
        ]
        for pose, code in CODES.items()
    }
