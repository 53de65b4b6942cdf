"""A glove on a serial port, played over a pseudo-terminal pair through pyserial itself."""

import os
import sys
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from glove_sdk_bridge.errors import BridgeError
from glove_sdk_bridge.serial_port import SerialGlove

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals like these")


class Wire:
    """A serial wire: what is written into `glove` is read from the port at `path`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.glove = -1
        self.plug_in()

    def plug_in(self) -> None:
        import tty

        self.glove, port = os.openpty()
        tty.setraw(port)
        self.path.symlink_to(os.ttyname(port))
        self._port = port

    def write(self, data: bytes) -> None:
        os.write(self.glove, data)

    def unplug(self) -> None:
        self.path.unlink(missing_ok=True)
        for end in (self.glove, self._port):
            if end >= 0:
                os.close(end)
        self.glove = self._port = -1


@pytest.fixture
def wire(tmp_path: Path) -> Iterator[Wire]:
    made = Wire(tmp_path / "ttyGLOVE")
    yield made
    made.unplug()


class Conversation:
    """Reads frames of a serial glove; `when` says what happens on the wire after which line was said."""

    def __init__(self, wire: Wire, when: dict[str, Callable[[], None]], **options: Any) -> None:
        self.said: list[str] = []
        self._when = when
        self.glove = SerialGlove(str(wire.path), say=self._on_message, wait=lambda _: None, **options)

    def _on_message(self, line: str) -> None:
        self.said.append(line)
        for words, act in list(self._when.items()):
            if words in line:
                del self._when[words]
                act()

    def bends(self, count: int) -> list[tuple[float, ...]]:
        return [frame.bend for frame in islice(self.glove.frames(), count)]


def test_both_encodings_are_read_among_garbage_in_any_pieces(wire: Wire) -> None:
    def speak() -> None:
        wire.write(b"5D6E7\n")  # the end of a line that began before the port was opened
        wire.write(b"A1B2C3D4E5F512G400H\r\n6,7,8")
        wire.write(b",9,10\n\xff\xfe#!\n\n" + b"x" * 2000 + b"\nA11B12C13D14E15(AB)7\n1,2,3\nA1B2C3D4E5\n")

    talk = Conversation(wire, {"reading": speak})
    frames = talk.glove.frames()
    bends = [frame.bend for frame in islice(frames, 4)]
    assert bends == [(1, 2, 3, 4, 5), (6, 7, 8, 9, 10), (11, 12, 13, 14, 15), (1, 2, 3, 4, 5)]
    wire.write(b"5,4,3,2,1\n")
    assert next(frames).bend == (5, 4, 3, 2, 1)
    assert len(talk.glove.dropped) == 3


def test_values_that_fall_when_a_finger_is_stretched_are_turned_round(wire: Wire) -> None:
    talk = Conversation(wire, {"reading": lambda: wire.write(b"A0B95C4095D1E2\n")}, invert=True)
    assert talk.bends(1) == [(4095, 4000, 0, 4094, 4093)]


def test_another_full_scale_turns_them_round_there(wire: Wire) -> None:
    talk = Conversation(
        wire, {"reading": lambda: wire.write(b"0,1,2,3,1023\n")}, invert=True, full_scale=1023
    )
    assert talk.bends(1) == [(1023, 1022, 1021, 1020, 0)]


def test_a_glove_that_is_unplugged_is_said_waited_for_and_read_again(wire: Wire) -> None:
    talk = Conversation(
        wire,
        {
            "reading": lambda: wire.write(b"1,2,3,4,5\n"),
            "is gone": wire.plug_in,
            "is back": lambda: wire.write(b"6,7,8,9,10\n"),
        },
    )
    frames = talk.glove.frames()
    assert next(frames).bend == (1, 2, 3, 4, 5)
    wire.unplug()
    assert next(frames).bend == (6, 7, 8, 9, 10)
    assert [line.removeprefix(str(wire.path)) for line in talk.said[1:]] == [
        " is gone; plug the glove in again",
        " is back",
    ]


def test_half_a_line_before_the_plug_was_pulled_is_not_joined_to_what_comes_after(wire: Wire) -> None:
    talk = Conversation(
        wire,
        {
            "reading": lambda: wire.write(b"1,2,3,4,5\n9,9,"),
            "is gone": wire.plug_in,
            "is back": lambda: wire.write(b"6,7,8,9,10\n"),
        },
    )
    frames = talk.glove.frames()
    next(frames)
    wire.unplug()
    assert next(frames).bend == (6, 7, 8, 9, 10)


def test_a_port_that_does_not_exist_is_named_together_with_those_that_do(tmp_path: Path) -> None:
    with pytest.raises(
        BridgeError, match=r"ttyNONE cannot be opened \(No such file.*(the ports here|no serial port)"
    ):
        SerialGlove(str(tmp_path / "ttyNONE"), say=pytest.fail)


def test_a_file_that_is_no_port_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("1,2,3,4,5\n")
    with pytest.raises(BridgeError, match="cannot be opened"):
        SerialGlove(str(path), say=pytest.fail)
