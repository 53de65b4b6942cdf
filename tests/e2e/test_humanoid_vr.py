"""Virtual reality with an emulated headset, the real service and the real control cycle."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell, new_cell
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

SERVICE = "whole_body_control"
WITHIN_S = 240.0
EMULATOR = REPOSITORY / "webui/app/node_modules/iwer/build/iwer.min.js"
# A person who sits somewhere in a room, looking another way, with both controllers in front of them.
WEAR = """
const device = new IWER.XRDevice(IWER.metaQuest3);
device.installRuntime({ forceInstall: true });
device.position.set(1, 1.15, 2);
for (const [side, x] of [["left", 0.8], ["right", 1.2]]) device.controllers[side].position.set(x, 0.9, 1.7);
window.headset = device;
"""
# Rendering in software is slow: the picture is small, which changes none of the poses.
SMALL = {"width": 640, "height": 480}
# Hold the right controller where the ball is to land.
CATCH = """([x, y, z]) => {
  // the seat is 1.15 m in front of the robot; the person looks along -z of the room
  headset.controllers.right.position.set(1 + y, z, 2 - (1.15 - x));
}"""


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """A cell with a humanoid that stands; its control process outlives the service, and is ended here."""
    data_dir = tmp_path_factory.mktemp("virtual_reality")
    folder = data_dir / "ports"
    with new_cell(data_dir) as made:
        made.extra = {
            "HANDOVER_HUMANOID_MODEL": "coman",
            "HANDOVER_HUMANOID_PORTS_DIR": str(folder),
            "HANDOVER_HUMANOID_FIFO": "false",
        }
        try:
            made.run("context_broker", SERVICE, "webui")
            wait_for(lambda: state(made)["fault"] is None, WITHIN_S, "the humanoid stands")
            yield made
        finally:
            made.stop()
            with suppress(OSError, ValueError):
                pid = int((folder / "control.pid").read_text())
                if str(folder).encode() in Path(f"/proc/{pid}/cmdline").read_bytes():
                    os.kill(pid, signal.SIGKILL)


def state(cell: Cell) -> dict[str, Any]:
    """Return the live document."""
    found: dict[str, Any] = httpx.get(f"{cell.url(SERVICE)}/state", timeout=120).raise_for_status().json()
    return found


def post(cell: Cell, path: str, **body: Any) -> dict[str, Any]:
    """Ask the service for something."""
    found: dict[str, Any] = (
        httpx.post(f"{cell.url(SERVICE)}/{path}", json=body, timeout=120).raise_for_status().json()
    )
    return found


def session(cell: Cell) -> dict[str, Any]:
    """Return the session of the live document."""
    found: dict[str, Any] = state(cell)["session"] or {}
    return found


def test_a_person_with_a_headset_catches_a_ball_and_a_lost_tracking_pauses_the_session(
    cell: Cell, open_page: OpenPage, keep: Callable[[Page, str], Path]
) -> None:
    page = open_page("/", viewport=SMALL, forgives=("XRSession", "already", "status of 502"))
    page.add_init_script(f"{EMULATOR.read_text()}\n{WEAR}")
    page.goto("/humanoid/vr")
    expect(page.get_by_role("application")).to_be_visible()
    page.get_by_text("Measure", exact=True).click()
    page.get_by_role("button", name="Enter virtual reality").click()

    def patient() -> dict[str, Any]:
        found: dict[str, Any] = state(cell)["patient"] or {}
        return found

    wait_for(lambda: patient().get("tracking") == "ok", WITHIN_S, "the poses reach the service")
    head = patient()["headset"]["position"]
    base = state(cell)["base"]
    assert abs(head[0] - base[0] - 1.15) < 0.05  # at the seat, whatever place in the room that is
    assert abs(head[1] - base[1]) < 0.05
    assert abs(head[2] - 1.15) < 0.05
    right, left = (patient()["hands"][side]["position"] for side in ("right", "left"))
    assert right[1] > left[1]  # the right hand of the person is at the left of the robot, which they face
    frames = page.locator("[data-measured=period]")
    expect(frames).not_to_have_attribute("data-count", "0")
    keep(page, "humanoid-vr")

    target = [0.8, 0.1, 0.6]
    begun = post(
        cell, "sessions", application="juggling", goal={"catches": 1}, target=target, isAdaptive=False
    )
    expect(page.locator("[data-session=running]")).to_be_visible()
    page.evaluate(CATCH, target)

    def has_ended() -> bool:  # it pauses for silence on a slow machine
        now = session(cell)["state"]
        if now == "paused":
            httpx.post(f"{cell.url(SERVICE)}/sessions/{begun['id']}/resume", timeout=120)
        return bool(now == "ended")

    wait_for(has_ended, WITHIN_S, "the ball is caught")
    assert (session(cell)["id"], session(cell)["endedBy"]) == (begun["id"], "goal")
    assert session(cell)["caught"] == 1
    assert session(cell)["score"] > 0
    keep(page, "humanoid-vr-caught")

    wait_for(lambda: state(cell)["behaviour"] in {"standing", "walking"}, WITHIN_S, "it stands again")
    begun = post(cell, "sessions", application="juggling", goal={"throws": 100})
    wait_for(lambda: session(cell)["state"] == "running", WITHIN_S, "a second session")
    page.evaluate("headset.position.set(1, 1.15, 3.5)")
    wait_for(lambda: session(cell)["state"] == "paused", WITHIN_S, "out of bounds")
    assert "outOfBounds" in session(cell)["pauseReason"] or "trackingLost" in session(cell)["pauseReason"]
    keep(page, "humanoid-vr-outside")
    page.evaluate("headset.position.set(1, 1.15, 2)")

    def resumes() -> bool:  # only by a person, and only once the cause is gone
        answer = httpx.post(f"{cell.url(SERVICE)}/sessions/{begun['id']}/resume", timeout=120)
        return answer.status_code == 200

    wait_for(resumes, WITHIN_S, "the session continues")
    page.evaluate("headset.updateVisibilityState('hidden')")
    wait_for(lambda: session(cell)["state"] == "paused", WITHIN_S, "the tracking is lost")
    wait_for(lambda: state(cell)["phase"] == "standing", WITHIN_S, "the robot stands")
    page.evaluate("headset.updateVisibilityState('visible')")
    wait_for(resumes, WITHIN_S, "the session continues")
    page.close()  # the headset drops out
    wait_for(lambda: session(cell)["state"] == "paused", WITHIN_S, "the silence pauses")
    assert session(cell)["pauseReason"] in {"silent", "trackingLost", "silent, trackingLost"}
    post(cell, f"sessions/{begun['id']}/end")
    wait_for(lambda: state(cell)["phase"] == "standing", WITHIN_S, "the robot stands")
