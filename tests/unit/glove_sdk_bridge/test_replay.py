"""Replay: frames at the pace at which they were made, by a clock that the test turns."""

from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glove_sdk_bridge.errors import BridgeError, Dropped
from glove_sdk_bridge.frames import Frame, Hello
from glove_sdk_bridge.recording import RecordingWriter
from glove_sdk_bridge.replay import Replay, read_table

HEADER = "pose,thumb,index,middle,ring,little\n"
TABLE = HEADER + "".join(f"{pose},{pose}00,{row},3,4,5\n" for pose in (0, 1, 2) for row in range(4))


class TurnedClock:
    """A clock that stands still unless somebody waits."""

    def __init__(self, now_s: float = 1000.0) -> None:
        self.now_s = now_s
        self.waits: list[float] = []

    def __call__(self) -> float:
        return self.now_s

    def wait(self, seconds: float) -> None:
        self.waits.append(seconds)
        self.now_s += seconds


def replay(path: Path, clock: TurnedClock, **options: Any) -> Replay:
    return Replay(path, say=lambda _: None, clock=clock, wait=clock.wait, **options)


def seen_at(path: Path, **options: Any) -> list[tuple[float, float, float]]:
    """When each frame comes, what time it bears, and its second value."""
    clock = TurnedClock()
    count = options.pop("count", None)
    frames = islice(replay(path, clock, **options).frames(), count)
    return [(round(clock.now_s - 1000, 6), round(frame.t_s - 1000, 6), frame.bend[1]) for frame in frames]


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "hands.csv"
    path.write_text(TABLE)
    return path


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "hand.jsonl"
    with RecordingWriter(path, Hello("glove-7", "left")) as writer:
        for t_s, value in [(5.0, 0), (5.01, 1), (5.5, 2), (60.0, 3)]:
            writer.write(Frame(t_s, (1, value, 3, 4, 5)))
    return path


def test_a_table_is_played_fifty_times_a_second(table: Path) -> None:
    times = [came for came, _, _ in seen_at(table)]
    assert times == [round(place / 50, 6) for place in range(12)]


def test_only_the_poses_that_are_asked_for_are_played(table: Path) -> None:
    clock = TurnedClock()
    assert [frame.bend[0] for frame in replay(table, clock, poses=("0", "2")).frames()] == [0] * 4 + [200] * 4


def test_twice_the_speed_takes_half_the_time_and_leaves_the_frames_their_own(table: Path) -> None:
    assert [(came, own) for came, own, _ in seen_at(table, speed=2.0, count=3)] == [
        (0, 0),
        (0.01, 0.02),
        (0.02, 0.04),
    ]


def test_a_recording_is_played_at_its_own_pace_and_a_long_gap_is_shortened(recording: Path) -> None:
    assert seen_at(recording) == [(0, 0, 0), (0.01, 0.01, 1), (0.5, 0.5, 2), (2.5, 2.5, 3)]


def test_a_recording_knows_the_hand(recording: Path, table: Path) -> None:
    assert replay(recording, TurnedClock()).hand == "left"
    assert replay(table, TurnedClock()).hand is None


def test_a_loop_goes_on_without_time_running_backwards(recording: Path) -> None:
    seen = seen_at(recording, loop=True, count=20)
    assert [value for _, _, value in seen] == [0, 1, 2, 3] * 5
    assert all(later > earlier for (_, earlier, _), (_, later, _) in pairwise(seen))


def test_a_replay_that_was_held_up_catches_up(table: Path) -> None:
    clock = TurnedClock()
    frames = replay(table, clock).frames()
    next(frames)
    clock.now_s += 0.1
    assert [round(next(frames).t_s - 1000, 6) for _ in range(5)] == [0.02, 0.04, 0.06, 0.08, 0.1]
    assert not clock.waits


def test_columns_may_come_in_any_order_with_others_between_them(tmp_path: Path) -> None:
    path = tmp_path / "hands.csv"
    path.write_bytes(b"\xef\xbb\xbfLittle, ring,who,middle,index,thumb\r\n5,4,me,3,2,1\r\n")
    assert next(replay(path, TurnedClock()).frames()).bend == (1, 2, 3, 4, 5)


def test_rows_that_are_no_frames_are_dropped_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "hands.csv"
    path.write_text(HEADER + "0,1,2,3,4,5\n0,1,2,3,4\n\n0,a,2,3,4,5\n0,nan,2,3,4,5\n0,9,2,3,4,5\n")
    played = replay(path, TurnedClock())
    assert [frame.bend[0] for frame in played.frames()] == [1, 9]
    assert set(played.dropped.by_rule) == {"a row needs a value in every column", "not a number"}


@given(st.text(max_size=200))
def test_any_rows_are_read_or_counted(tmp_path_factory: pytest.TempPathFactory, rows: str) -> None:
    path = tmp_path_factory.mktemp("table") / "any.csv"
    path.write_text(HEADER + rows, encoding="utf-8", errors="replace")
    for _, frame in read_table(path, Dropped("any", lambda _: None)):
        assert len(frame.bend) == 5


@given(st.binary(max_size=200))
def test_any_file_is_played_or_refused_in_one_line(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path = tmp_path_factory.mktemp("table") / "any.csv"
    path.write_bytes(content)
    with pytest.raises(BridgeError) as refused:
        replay(path, TurnedClock())
    assert "\n" not in str(refused.value)


def test_a_cell_without_end_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "hands.csv"
    path.write_text(HEADER + "0,1,2,3,4,5\n" + "x" * 200_000 + "\n0,1,2,3,4,6\n")
    played = replay(path, TurnedClock())
    assert [frame.bend[4] for frame in played.frames()] == [5, 6]
    assert len(played.dropped) > 0


@pytest.mark.parametrize(
    ("content", "options", "words"),
    [
        ("", {}, "no column thumb, index"),
        (HEADER, {}, "holds no frames"),
        (HEADER + "0,1,2,3,4,5\n1,1,2,3,4,5\n", {"poses": ("7",)}, "no frames of pose 7; its poses are 0, 1"),
        ('{"type":"hello"}\n', {}, "holds no frames"),
        ('{"type":"hello"}\n', {"poses": ("1",)}, "has no poses"),
    ],
)
def test_a_file_that_cannot_be_played_says_why(
    tmp_path: Path, content: str, options: dict[str, Any], words: str
) -> None:
    path = tmp_path / "file"
    path.write_text(content)
    with pytest.raises(BridgeError, match=words):
        replay(path, TurnedClock(), **options)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(BridgeError, match=r"gone\.csv cannot be read"):
        replay(tmp_path / "gone.csv", TurnedClock())


def test_the_real_recordings_are_played(recordings: Path) -> None:
    clock = TurnedClock()
    frames = list(replay(recordings / "person_b.csv", clock, poses=("5",)).frames())
    assert len(frames) == 2060
    assert clock.now_s == pytest.approx(1000 + 2059 / 50)
