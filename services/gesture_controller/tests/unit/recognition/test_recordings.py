"""Real hands: a person who calibrates is understood, and never taken for showing another gesture."""

import csv
from itertools import groupby
from pathlib import Path

import pytest

from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.gestures import M2O2P_GESTURES, Gestures
from handover_gloves.recognition.hold import HoldEvent
from handover_gloves.recognition.levels import calibrate
from handover_gloves.recognition.pipeline import PipelineState, RecognitionConfig, process_frame
from handover_gloves.recognition.thresholds import FINGERS

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


def states_after(frames: list[list[float]], config: RecognitionConfig) -> list[PipelineState]:
    seen = [PipelineState()]
    for count, bend in enumerate(frames):
        seen.append(process_frame(seen[-1], Frame(count / 50, bend), config))
    return seen[1:]


def config_of(poses: Poses) -> RecognitionConfig:
    return RecognitionConfig(calibrate(poses["0"], poses["5"]).thresholds, Gestures(M2O2P_GESTURES))


@pytest.mark.parametrize("pose", SHOWN)
def test_person_b_is_understood_in_nearly_every_frame(recordings: Path, pose: str) -> None:
    poses = poses_of(recordings, "b")
    seen = states_after(poses[pose], config_of(poses))
    right = sum(state.gesture == SHOWN[pose] for state in seen) / len(seen)
    assert right >= 0.98
    confirmed = {state.gesture for state in seen if state.hold.last is HoldEvent.CONFIRMED}
    assert confirmed == {SHOWN[pose]}


@pytest.mark.parametrize("pose", ["0", "4", "5", "7", "9"])
def test_what_person_b_does_not_mean_confirms_nothing(recordings: Path, pose: str) -> None:
    poses = poses_of(recordings, "b")
    seen = states_after(poses[pose], config_of(poses))
    assert not [state for state in seen if state.hold.last is HoldEvent.CONFIRMED]


@pytest.mark.parametrize("person", ["a", "b", "c"])
def test_everybody_can_calibrate(recordings: Path, person: str) -> None:
    poses = poses_of(recordings, person)
    for threshold in config_of(poses).thresholds.fingers:
        assert threshold.lower < threshold.upper
