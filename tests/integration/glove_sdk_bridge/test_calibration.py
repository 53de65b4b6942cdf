"""A glove is fitted to its wearer through the real controller: a fist, then an open hand."""

import threading
import time
from pathlib import Path

import httpx
import pytest

from glove_sdk_bridge.calibration import Calibrator
from glove_sdk_bridge.controller_client import ControllerClient, Declined
from glove_sdk_bridge.errors import BridgeError
from glove_sdk_bridge.frame_sender import FrameSender
from glove_sdk_bridge.frames import Frame, Hello
from tests.kit.cell import Cell

FIST, OPEN = [301, 402, 503, 404, 305], [701, 802, 903, 804, 705]


class WornGlove:
    """A glove that follows the instructions, with some noise."""

    def __init__(self, port: int) -> None:
        self.said: list[str] = []
        self._stop = threading.Event()
        self._port = port
        self._thread = threading.Thread(target=self._send)

    def listen(self, words: str) -> None:
        self.said.append(words)

    def __enter__(self) -> "WornGlove":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(timeout=120)

    def _send(self) -> None:
        with FrameSender(Hello("glove-1"), "127.0.0.1", self._port, say=lambda _: None) as link:
            place = 0
            while not self._stop.wait(0.01):
                place += 1
                instruction = self.said[-1] if self.said else ""
                hand = OPEN if "open" in instruction else FIST
                link.send(Frame(time.monotonic(), tuple(value + place % 3 for value in hand)))


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests: only the first makes thresholds."""
    return shared_cell


@pytest.fixture
def controller(cell: Cell) -> ControllerClient:
    cell.run("context_broker", "gesture_controller")
    return ControllerClient(cell.url("gesture_controller"))


@pytest.mark.nightly
def test_a_person_makes_a_fist_and_opens_the_hand_and_the_glove_fits(
    cell: Cell, controller: ControllerClient
) -> None:
    with WornGlove(cell.ports["glove"]) as glove:
        calibrator = Calibrator("glove-1", controller, say=glove.listen, wait=lambda s: time.sleep(s / 4))
        calibrator.from_hand(threading.Event())
    assert "make a fist" in glove.said[0]
    assert "open your hand" in glove.said[1]
    assert "glove-1 is calibrated" in glove.said[2]
    made = httpx.get(f"{controller.url}/gloves/glove-1", timeout=120).json()["thresholds"]
    for finger, bent, straight in zip(made, FIST, OPEN, strict=True):
        assert bent < made[finger]["lower"] < made[finger]["upper"] < straight


def test_the_error_for_a_silent_glove_says_to_switch_it_on(controller: ControllerClient) -> None:
    ticks = iter(range(1_000_000))
    calibrator = Calibrator(
        "glove-1", controller, say=lambda _: None, clock=lambda: next(ticks) / 10, wait=lambda _: None
    )
    with pytest.raises(BridgeError, match=r"glove-1 sends nothing .* switch it on"):
        calibrator.from_hand(threading.Event())


def test_a_table_without_the_pose_or_with_a_hand_that_never_moves_is_refused(
    controller: ControllerClient, tmp_path: Path
) -> None:
    table = tmp_path / "still.csv"
    rows = [f"{pose},500,500,500,500,500" for pose in (0, 5) for _ in range(50)]
    table.write_text("\n".join(["pose,thumb,index,middle,ring,little", *rows]))
    calibrator = Calibrator("glove-1", controller, say=lambda _: None)
    with pytest.raises(BridgeError, match="no frames of pose 7"):
        calibrator.from_table(table, "7", "5", 1.0)
    with pytest.raises(Declined, match="thumb"):
        calibrator.from_table(table, "0", "5", 1.0)
