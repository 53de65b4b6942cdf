"""The link against a real TCP server: it carries, mends itself, drops what is stale, and knows a refusal."""

import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from glove_sdk_bridge.errors import BridgeError
from glove_sdk_bridge.frame_sender import MAX_FRAME_AGE_S, MAX_WAITING, FrameSender, Refused
from glove_sdk_bridge.frames import Frame, Hello
from glove_sdk_bridge.source import stream

HELLO = Hello("glove-1", "left", token="s3cret")


def hand(value: int) -> Frame:
    return Frame(value / 50, (value, 2, 3, 4, 5))


def sender_to(
    port: int, said: list[str] | None = None, clock: Callable[[], float] = time.monotonic
) -> FrameSender:
    say = (said if said is not None else []).append
    return FrameSender(HELLO, "127.0.0.1", port, say=say, chance=random.Random(1), clock=clock)


def test_frames_arrive_numbered_and_in_order_after_the_hello(desk: Any, eventually: Any) -> None:
    with sender_to(desk.port) as link:
        assert link.wait_until_connected(10)
        for value in range(500):
            link.send(hand(value))
        link.finish(10)
        assert (link.sent, link.dropped) == (500, 0)
        eventually(lambda: len(desk.frames) == 500)
    assert desk.visits[0].hello == HELLO
    assert [(frame.seq, frame.bend[0]) for frame in desk.frames] == [(value, value) for value in range(500)]
    eventually(lambda: desk.visits[0].ended)


def test_the_last_frame_arrives_even_if_the_link_is_closed_at_once(desk: Any, eventually: Any) -> None:
    for _ in range(10):
        with sender_to(desk.port) as link:
            assert link.wait_until_connected(10)
            for value in range(50):
                link.send(hand(value))
            link.finish(10)
    eventually(lambda: all(visit.ended for visit in desk.visits))
    assert [len(visit.frames) for visit in desk.visits] == [50] * 10


def test_a_controller_that_is_not_there_yet_is_waited_for_and_said_once(
    closed_desk: Any, eventually: Any
) -> None:
    desk, port, said = closed_desk, closed_desk.port, list[str]()
    with sender_to(port, said) as link:
        eventually(lambda: said)
        desk.open()
        assert link.wait_until_connected(20)
        link.send(hand(1))
        eventually(lambda: desk.frames)
    assert [line.split(" (")[0] for line in said] == [
        f"127.0.0.1:{port} does not take the glove's frames",
        f"glove-1 is connected to 127.0.0.1:{port}",
    ]


def test_a_broken_connection_is_restored_and_sends_no_old_frames(
    desk: Any, make_desk: Callable[..., Any], eventually: Any
) -> None:
    first, said, now_s = desk, list[str](), [0.0]
    with sender_to(first.port, said, clock=lambda: now_s[0]) as link:
        assert link.wait_until_connected(10)
        link.send(hand(0))
        eventually(lambda: first.frames)
        first.close()
        eventually(lambda: not link.connected)
        for value in range(1, 11):
            link.send(hand(value))
        now_s[0] += 1.1 * MAX_FRAME_AGE_S
        for value in range(11, 14):
            link.send(hand(value))
        second = make_desk(first.port)
        second.open()
        assert link.wait_until_connected(20)
        eventually(lambda: len(second.frames) == 3)
    assert [(frame.seq, frame.bend[0]) for frame in second.frames] == [(11, 11), (12, 12), (13, 13)]
    assert (link.sent, link.dropped) == (4, 10)
    assert "10 frames were dropped meanwhile" in said[-1]


def test_a_controller_that_dies_again_and_again_is_found_again_each_time(desk: Any, eventually: Any) -> None:
    with sender_to(desk.port) as link:
        for visit in range(4):
            eventually(lambda visit=visit: len(desk.visits) == visit + 1 and link.connected)
            desk.visits[-1].hang_up()
            eventually(lambda visit=visit: desk.visits[visit].ended)


def test_sending_never_waits_and_the_memory_is_bounded(closed_desk: Any) -> None:
    with sender_to(closed_desk.port) as link:
        for value in range(3 * MAX_WAITING):
            link.send(hand(value))
        link.finish(0)
        assert link.dropped == 3 * MAX_WAITING


def test_a_controller_that_stops_reading_costs_frames_but_never_blocks(eventually: Any) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, sender_to(server.getsockname()[1]) as link:
        line, _ = server.accept()
        with line:
            line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            line.sendall(b'{"type":"ack"}\n')
            assert link.wait_until_connected(10)
            frame = Frame(1.0, (1, 2, 3, 4, 5), pressure=(1, 2, 3, 4, 5))

            def dropped() -> int:
                for _ in range(200):
                    link.send(frame)
                return link.dropped

            eventually(dropped)


@pytest.mark.parametrize(
    "refusal",
    [
        b'{"type":"error","reason":"the token is wrong; give the glove the HANDOVER_GLOVE_TOKEN"}\n',
        b'{"type":"error","reason":"no hello within 5 s","retry":false}\n',
    ],
)
def test_a_refused_hello_ends_it_with_the_controllers_words(desk: Any, refusal: bytes) -> None:
    desk.answer = refusal
    with sender_to(desk.port) as link, pytest.raises(Refused) as refused:
        stream(Endless(), link, threading.Event(), lambda _: None)
    reason = refusal.split(b'"')[7].decode()
    assert str(refused.value) == f"127.0.0.1:{desk.port} refuses glove-1: {reason}"
    assert "s3cret" not in str(refused.value)


@pytest.mark.parametrize(
    "passing",
    [
        b'{"type":"error","reason":"the controller stops; connect again in a moment","retry":true}\n',
        b'{"type":"error","reason":"too many wait to say hello; say it at once","retry":true}\n',
        b'{"type":"error","reason":"too many gloves","retry":true}\n',
        b"what?\n",
    ],
)
def test_a_controller_that_is_only_busy_is_tried_again(desk: Any, eventually: Any, passing: bytes) -> None:
    desk.answer = passing
    with sender_to(desk.port) as link:
        eventually(lambda: desk.visits and desk.visits[0].hello)
        desk.visits[0].hang_up()
        desk.answer = b'{"type":"ack"}\n'
        assert link.wait_until_connected(20)
        assert link.failure is None


def test_what_goes_wrong_after_the_welcome_is_worth_another_try(desk: Any, eventually: Any) -> None:
    with sender_to(desk.port) as link:
        assert link.wait_until_connected(10)
        desk.visits[0].say(b'{"type":"error","reason":"a line holds at most 65536 bytes"}\n')
        eventually(lambda: len(desk.visits) == 2)
        assert link.wait_until_connected(10)


def test_a_glove_that_is_worn_elsewhere_now_gives_up(desk: Any, eventually: Any) -> None:
    with sender_to(desk.port) as link:
        assert link.wait_until_connected(10)
        desk.visits[0].say(
            b'{"type":"error","reason":"glove-1 has connected again from elsewhere; '
            b'only its newest connection counts","retry":false}\n'
        )
        eventually(lambda: link.failure)
    assert len(desk.visits) == 1


class Endless:
    """Frames without end."""

    patience_s = 0.0
    dropped = None

    def frames(self) -> Iterator[Frame]:
        while True:
            yield hand(1)
            time.sleep(0.01)


class Broken:
    """A source that comes to a dead end."""

    patience_s = 0.0
    dropped = None

    def __init__(self, error: Exception) -> None:
        self.error = error

    def frames(self) -> Iterator[Frame]:
        yield hand(1)
        raise self.error


class Stuck:
    """A source that is blocked in a read for ever."""

    patience_s = 0.0
    dropped = None

    def __init__(self) -> None:
        self.reading = threading.Event()

    def frames(self) -> Iterator[Frame]:
        self.reading.set()
        threading.Event().wait()
        yield hand(1)


@pytest.mark.parametrize("error", [BridgeError("the glove is broken"), ZeroDivisionError("a fault of ours")])
def test_what_goes_wrong_in_a_source_is_raised_where_it_is_streamed(desk: Any, error: Exception) -> None:
    with sender_to(desk.port) as link, pytest.raises(type(error)):
        stream(Broken(error), link, threading.Event(), lambda _: None)


def test_a_source_that_is_stuck_does_not_keep_us_from_stopping(desk: Any) -> None:
    stop, source, said = threading.Event(), Stuck(), list[str]()
    threading.Thread(target=lambda: (source.reading.wait(), stop.set())).start()
    with sender_to(desk.port) as link:
        stream(source, link, stop, said.append)
    assert said == ["0 frames sent, 0 dropped"]
