"""The recorder takes down what a glove sends, from a real controller, however often that goes away."""

import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from glove_sdk_bridge.__main__ import main
from glove_sdk_bridge.controller_client import ControllerClient, Declined
from glove_sdk_bridge.errors import Dropped
from glove_sdk_bridge.frame_sender import FrameSender
from glove_sdk_bridge.frames import Frame, Hello
from glove_sdk_bridge.recorder import Recorder
from glove_sdk_bridge.recording import hello_of, read_recording
from tests.kit.cell import Cell

pytestmark = pytest.mark.slow


def frames_in(path: Path) -> list[Frame]:
    return list(read_recording(path, Dropped(str(path), pytest.fail))) if path.exists() else []


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests: what is recorded is what is sent meanwhile."""
    return shared_cell


@pytest.fixture
def worn(cell: Cell) -> Iterator[Callable[..., FrameSender]]:
    """Put a glove on that is on the line of a running controller."""
    cell.run("context_broker", "gesture_controller")
    links: list[FrameSender] = []

    def put_on(hello: Hello) -> FrameSender:
        link = FrameSender(hello, "127.0.0.1", cell.ports["glove"], say=lambda _: None)
        links.append(link.__enter__())
        assert link.wait_until_connected(20)
        return link

    yield put_on
    for link in links:
        link.__exit__(None, None, None)


@pytest.mark.nightly
def test_what_a_glove_sends_is_recorded_and_can_be_replayed(
    cell: Cell, desk: Any, worn: Any, eventually: Any, tmp_path: Path
) -> None:
    path, stop, said = tmp_path / "hand.jsonl", threading.Event(), list[str]()
    link = worn(Hello("glove-5", "left"))
    recorder = Recorder(path, "glove-5", ControllerClient(cell.url("gesture_controller")), say=said.append)
    recording = threading.Thread(target=recorder.record, args=(stop,))
    recording.start()
    sent = 0
    while len(frames_in(path)) < 50:
        link.send(Frame(sent / 100, (sent, 2, 3, 4, 5), pressure=(0, 0, 0, 0, 1)))
        sent += 1
        link.finish(10)
        assert sent < 20_000
    stop.set()
    recording.join(timeout=120)
    assert not recording.is_alive()
    recorded = frames_in(path)
    first = recorded[0].seq
    assert [frame.bend[0] for frame in recorded] == list(range(first, first + len(recorded)))
    assert recorded[0].pressure == (0, 0, 0, 0, 1)
    assert hello_of(path) == Hello("glove-5", "left")
    assert said[-1] == f"{len(recorded)} frames recorded, 0 dropped"

    assert main(["replay", str(path), "--port", str(desk.port), "--speed", "50"]) == 0
    eventually(lambda: len(desk.frames) == len(recorded))
    assert [frame.bend for frame in desk.frames] == [frame.bend for frame in recorded]


def test_a_controller_that_was_killed_is_waited_for_and_the_recording_goes_on(
    cell: Cell, worn: Any, eventually: Any, tmp_path: Path
) -> None:
    path, stop, said = tmp_path / "hand.jsonl", threading.Event(), list[str]()
    link = worn(Hello("glove-1"))
    recorder = Recorder(path, "glove-1", ControllerClient(cell.url("gesture_controller")), say=said.append)
    recording = threading.Thread(target=recorder.record, args=(stop,))
    recording.start()
    clock = iter(range(1_000_000))

    def more_than(count: int) -> bool:
        link.send(Frame(next(clock) / 100, (1, 2, 3, 4, 5)))
        return len(frames_in(path)) > count

    eventually(lambda: more_than(20))
    cell.kill("gesture_controller")
    eventually(lambda: any("is not available" in line for line in said))
    before = len(frames_in(path))
    cell.start("gesture_controller")
    eventually(lambda: more_than(before + 20))
    stop.set()
    recording.join(timeout=120)
    assert not recording.is_alive()
    assert any("is available again" in line for line in said)


def test_recording_for_some_seconds_ends_by_itself(cell: Cell, worn: Any, tmp_path: Path) -> None:
    worn(Hello("glove-1"))
    path = tmp_path / "hand.jsonl"
    words = ["record", str(path), "--controller", cell.url("gesture_controller"), "--seconds", "0.5"]
    assert main(words) == 0
    assert json.loads(path.read_text().splitlines()[0])["glove"] == "glove-1"


def test_a_glove_that_the_controller_does_not_know_is_said_in_one_line(
    cell: Cell, worn: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    worn(Hello("glove-1"))
    path = tmp_path / "hand.jsonl"
    url = cell.url("gesture_controller")
    assert main(["record", str(path), "--glove", "nobodys", "--controller", url]) == 2
    assert 'there is no glove "nobodys"' in capsys.readouterr().err
    assert not path.exists()
    with pytest.raises(Declined) as declined:
        ControllerClient(url).glove("nobodys")
    assert declined.value.status == 404
