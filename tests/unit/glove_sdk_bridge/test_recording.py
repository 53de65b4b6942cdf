"""Recordings: written so that a crash costs no more than the last line, read whatever happened to them."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glove_sdk_bridge.errors import BridgeError, Dropped
from glove_sdk_bridge.frames import Frame, Hello
from glove_sdk_bridge.recording import RecordingWriter, hello_of, is_recording, read_recording

HELLO = Hello("glove-1", "left", token="s3cret")


def hand(value: int) -> Frame:
    return Frame(100 + value / 50, (value, 2, 3, 4, 5), value)


def read(path: Path) -> tuple[list[Frame], Dropped]:
    dropped = Dropped(str(path), lambda _: None)
    return list(read_recording(path, dropped)), dropped


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "hand.jsonl"


def test_what_is_recorded_is_read_again(path: Path) -> None:
    written = [hand(value) for value in range(100)]
    with RecordingWriter(path, HELLO) as recording:
        for frame in written:
            recording.write(frame)
    frames, dropped = read(path)
    assert frames == written
    assert not len(dropped)
    assert is_recording(path)
    assert hello_of(path) == Hello("glove-1", "left")


def test_the_token_is_not_recorded(path: Path) -> None:
    RecordingWriter(path, HELLO).close()
    assert b"s3cret" not in path.read_bytes()


@given(cut=st.integers(0, 200))
def test_a_recording_cut_off_anywhere_is_read_up_to_there_and_can_be_continued(
    tmp_path_factory: pytest.TempPathFactory, cut: int
) -> None:
    path = tmp_path_factory.mktemp("recording") / "hand.jsonl"
    with RecordingWriter(path, HELLO) as recording:
        for value in range(10):
            recording.write(hand(value))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) - cut])
    frames, _ = read(path)
    complete = path.read_bytes().count(b"\n") - 1
    assert len(frames) in {complete, complete + 1}  # only the line's end may be missing
    with RecordingWriter(path, HELLO) as recording:
        recording.write(hand(10))
    frames, dropped = read(path)
    assert not len(dropped)
    assert [frame.bend[0] for frame in frames] == [*range(complete), 10]


def test_a_second_session_goes_on_where_the_first_ended_in_time(path: Path) -> None:
    for _ in range(2):
        with RecordingWriter(path, HELLO) as recording:
            recording.write(hand(0))
            recording.write(hand(1))
    frames, _ = read(path)
    assert [round(frame.t_s - frames[0].t_s, 6) for frame in frames] == [0, 0.02, 0.04, 0.06]


def test_fingers_recorded_in_another_order_are_put_thumb_first(path: Path) -> None:
    hello = Hello("glove-1", sensors=("little", "ring", "middle", "index", "thumb"))
    path.write_bytes(hello.encode() + Frame(1.0, (5, 4, 3, 2, 1)).encode())
    assert read(path)[0][0].bend == (1, 2, 3, 4, 5)


def test_garbage_in_a_recording_is_dropped_and_counted(path: Path) -> None:
    path.write_bytes(
        HELLO.encode()
        + b'garbage\n\n{"type":"hello"}\n{"type":"frame","t":1,"bend":[1,NaN,3,4,5]}\n'
        + b"x" * 70_000
        + b"\n"
        + hand(1).encode()
    )
    frames, dropped = read(path)
    assert frames == [hand(1)]
    assert len(dropped) == 4


@given(st.binary(max_size=400))
def test_any_file_is_read_without_a_crash(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("recording") / "any"
    path.write_bytes(content)
    frames, _ = read(path)
    assert not frames
    assert hello_of(path) is None


def test_a_file_that_is_something_else_is_not_overwritten(path: Path) -> None:
    path.write_text("my thesis")
    with pytest.raises(BridgeError, match="no recording of ours"):
        RecordingWriter(path, HELLO)
    assert path.read_text() == "my thesis"


def test_a_recording_of_another_glove_is_not_continued(path: Path) -> None:
    RecordingWriter(path, HELLO).close()
    before = path.read_bytes()
    with pytest.raises(BridgeError, match="recording of glove-1"):
        RecordingWriter(path, Hello("glove-2"))
    assert path.read_bytes() == before


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(BridgeError, match=r"nowhere/hand.jsonl cannot be written"):
        RecordingWriter(tmp_path / "nowhere" / "hand.jsonl", HELLO)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, which only Linux has")
def test_a_full_disk_is_named() -> None:
    with pytest.raises(BridgeError, match="No space left"):
        RecordingWriter(Path("/dev/full"), HELLO)


def test_every_line_is_in_the_file_as_soon_as_it_is_written(path: Path) -> None:
    with RecordingWriter(path, HELLO) as recording:
        for value in range(3):
            recording.write(hand(value))
            assert path.read_bytes().count(b"\n") == value + 2
