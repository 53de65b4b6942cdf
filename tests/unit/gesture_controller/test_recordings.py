"""Real hands: a person who calibrates is understood, and never taken for showing another gesture."""

import csv
from itertools import groupby
from pathlib import Path

import pytest

from services.gesture_controller.calibration.levels import calibrate
from services.gesture_controller.frames import Frame
from services.gesture_controller.gestures import M2O2P_GESTURES, Gestures
from services.gesture_controller.hold import HoldEvent
from services.gesture_controller.pipeline import Senses, Sight, see
from services.gesture_controller.thresholds import FINGERS

Poses = dict[str, list[list[float]]]
SHOWN = {
    "1": "Point with index",
    "2": "Index and middle straight",
    "3": "Middle, ring and little straight",
    "6": "Thumb and little straight",
    "8": "Thumb and index straight",
}


def poses_of(recordings: Path, person: str) -> Poses:
    with (recordings / f"person_{person}.csv").open() as file:
        rows = list(csv.DictReader(file))
    return {
        pose: [[float(row[finger]) for finger in FINGERS] for row in group]
        for pose, group in groupby(rows, key=lambda row: row["pose"])
    }


def sights(frames: list[list[float]], senses: Senses) -> list[Sight]:
    seen = [Sight()]
    for count, bend in enumerate(frames):
        seen.append(see(seen[-1], Frame(count / 50, bend), senses))
    return seen[1:]


def senses_of(poses: Poses) -> Senses:
    return Senses(calibrate(poses["0"], poses["5"]).thresholds, Gestures(M2O2P_GESTURES))


@pytest.mark.parametrize("pose", SHOWN)
def test_person_b_is_understood_in_nearly_every_frame(recordings: Path, pose: str) -> None:
    poses = poses_of(recordings, "b")
    seen = sights(poses[pose], senses_of(poses))
    right = sum(sight.gesture == SHOWN[pose] for sight in seen) / len(seen)
    assert right >= 0.98
    confirmed = {sight.gesture for sight in seen if sight.hold.last is HoldEvent.CONFIRMED}
    assert confirmed == {SHOWN[pose]}


@pytest.mark.parametrize("pose", ["0", "4", "5", "7", "9"])
def test_what_person_b_does_not_mean_confirms_nothing(recordings: Path, pose: str) -> None:
    poses = poses_of(recordings, "b")
    seen = sights(poses[pose], senses_of(poses))
    assert not [sight for sight in seen if sight.hold.last is HoldEvent.CONFIRMED]


@pytest.mark.parametrize("person", ["a", "b", "c"])
def test_everybody_can_calibrate(recordings: Path, person: str) -> None:
    poses = poses_of(recordings, person)
    for threshold in senses_of(poses).thresholds.fingers:
        assert threshold.lower < threshold.upper
