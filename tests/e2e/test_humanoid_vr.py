"""Virtual reality with an emulated headset, the real service and the real control cycle."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from playwright.sync_api import Error, Page, expect

from handover_humanoid.model.kinematics import Kinematics
from handover_humanoid.robots import humanoid
from services.whole_body_control.tests.integration.people import THROW_S
from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell, new_cell
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import scaled, wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(600)]

SERVICE = "whole_body_control"
WITHIN_S = 240.0
EMULATOR = REPOSITORY / "webui/app/node_modules/iwer/build/iwer.min.js"
# A person who sits somewhere in a room, looking another way, with both controllers in front of them.
WEAR = """
const device = new IWER.XRDevice(IWER.metaQuest3);
device.installRuntime({ forceInstall: true });
device.position.set(1, 1.15, 2);
for (const held of [device.controllers, device.hands])
  for (const [side, x] of [["left", 0.8], ["right", 1.2]]) held[side].position.set(x, 0.9, 1.7);
window.headset = device;
window.pulses = [];
const actuator = device.controllers.right.inputSource.gamepad.hapticActuators[0];
Object.getPrototypeOf(actuator).pulse = (_, ms) => Promise.resolve(pulses.push(ms));
"""
# Rendering in software is slow: the picture is small, which changes none of the poses.
SMALL = {"width": 640, "height": 480}
# Hold the right controller where the ball is to land.
CATCH = """([x, y, z]) => {
  // the seat is 1.15 m in front of the robot; the person looks along -z of the room
  headset.controllers.right.position.set(1 + y, z, 2 - (1.15 - x));
}"""

# Hold the right controller at a place of the room, and point it at another one.
AIM = """([from, to]) => {
  const [x, y, z] = [0, 1, 2].map((axis) => to[axis] - from[axis]);
  const [yaw, pitch] = [Math.atan2(-x, -z) / 2, Math.atan2(y, Math.hypot(x, z)) / 2];
  headset.controllers.right.position.set(...from);
  headset.controllers.right.quaternion.set(
    Math.cos(yaw) * Math.sin(pitch), Math.sin(yaw) * Math.cos(pitch),
    -Math.sin(yaw) * Math.sin(pitch), Math.cos(yaw) * Math.cos(pitch),
  );
}"""
FRAMES = (
    "async () => { for (let i = 0; i < 4; i++) await new Promise((next) => requestAnimationFrame(next)); }"
)
PUT_HAND = "([side, place]) => headset.hands[side].position.set(...place)"
PINCH = "(value) => { for (const side of ['left', 'right']) headset.hands[side].updatePinchValue(value); }"
THROWN_MS = 40
Place = tuple[float, float, float]


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


@pytest.fixture(autouse=True)
def standing(cell: Cell) -> Iterator[None]:
    """Begin and end each test with a robot that stands and has no session, also after a test that failed."""
    stand(cell)
    yield
    stand(cell)


def stand(cell: Cell) -> None:
    """End the session that runs, and let the robot stand."""
    now = session(cell)
    if now and now["state"] != "ended":
        post(cell, f"sessions/{now['id']}/end")

    def stands() -> bool:  # a choice is refused until the robot has finished what it did
        answer = httpx.post(f"{cell.url(SERVICE)}/behaviour", json={"behaviour": "walking"}, timeout=120)
        return answer.status_code == 200 and state(cell)["behaviour"] == "standing"

    wait_for(stands, WITHIN_S, "the robot stands")


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


def patient(cell: Cell) -> dict[str, Any]:
    """Return the person as the live document has them."""
    found: dict[str, Any] = state(cell)["patient"] or {}
    return found


def has_both_hands(cell: Cell) -> bool:
    """Whether both hands of the person are tracked."""
    hands = patient(cell).get("hands") or {}
    return all(hands.get(side) for side in ("left", "right"))


def headset(cell: Cell) -> dict[str, Any]:
    """Return the pose of the head; while a slow page says nothing there is none."""
    return wait_for(lambda: patient(cell).get("headset"), WITHIN_S, "the head reaches the service")


def in_room(place: Place) -> list[float]:
    """Return a place of the robot (ahead, to its left, up) in the room of the person, who faces the robot."""
    ahead, left, up = place
    return [1 + left, up, 2 - (1.15 - ahead)]


def in_stance(cell: Cell, place: Place) -> tuple[float, float]:
    """Return where `place` of `in_room` is in the frame of the feet: the seat faces the robot as it stood."""
    head, feet = headset(cell), state(cell)["stance"]
    turn = 2 * np.arctan2(head["rotation"][2], head["rotation"][3]) + np.pi
    x, y = np.array(head["position"][:2]) + turned(place[0] - 1.15, place[1], turn)
    feet_x, feet_y, yaw = feet
    ahead, left = turned(x - feet_x, y - feet_y, -yaw)
    return float(ahead), float(left)


def turned(x: float, y: float, yaw: float) -> np.ndarray:
    return np.array([np.cos(yaw) * x - np.sin(yaw) * y, np.sin(yaw) * x + np.cos(yaw) * y])


def robot_hands(cell: Cell) -> dict[str, Place]:
    """Return where the hands of the robot are, in the frame of its base on the ground."""
    now, coman = state(cell), humanoid("coman")
    kinematics = Kinematics(coman)
    kinematics.update(np.array([*now["base"], *now["joints"]]))
    yaw = 2 * np.arctan2(now["base"][5], now["base"][6])
    found = {}
    for side in ("left", "right"):
        grip = coman.grips[f"{side}_hand"]
        x, y, z = kinematics.pose(grip.link).act(np.array(grip.point))
        x, y = x - now["base"][0], y - now["base"][1]
        ahead, left = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
        found[side] = (float(ahead), float(left), float(z))
    return found


class Wearer:
    """A person with the headset, before the panel in the scene."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.panel = page.get_by_role("region", name="What the person sees on the panel")

    def press(self, button: str) -> None:
        """Press a button of a controller."""
        for value in (1, 0):
            self.page.evaluate(
                "([id, value]) => headset.controllers.right.updateButtonValue(id, value)", [button, value]
            )
            self.page.evaluate(FRAMES)

    def choose(self, label: str) -> None:
        """Point at a button of the panel, and pull the trigger, until the button is gone."""
        wait_for(lambda: self.try_to_choose(label), WITHIN_S, f"{label} is chosen")

    def try_to_choose(self, label: str) -> bool:
        """Do it once; return whether the button is gone."""
        labels = self.panel.get_by_role("button").all_inner_texts()
        if label not in labels:
            return False
        width = (1280 - 80 - (len(labels) - 1) * 24) / len(labels)
        across = (40 + labels.index(label) * (width + 24) + width / 2) / 1280
        self.point_at([0.35 + 1.3 * across, 1.206, -0.05])
        self.press("trigger")
        with suppress(AssertionError):  # the panel changed meanwhile, and the ray missed: point again
            expect(self.panel.get_by_role("button", name=label, exact=True)).to_be_hidden(
                timeout=1000 * scaled(3)
            )
            return True
        return False

    def point_at(self, place: list[float]) -> None:
        """Point the right controller at a place of the room."""
        self.page.evaluate(AIM, [[1.2, 1.0, 1.7], place])
        self.page.evaluate(FRAMES)


def test_a_person_without_a_headset_catches_by_the_pointer_and_pauses_by_the_panel(
    cell: Cell, open_page: OpenPage, accessible: Callable[[Page], None], keep: Callable[[Page, str], Path]
) -> None:
    page = open_page("/care/exercises/vr", viewport=SMALL, forgives=("status of 409",))
    page.set_default_timeout(1000 * WITHIN_S)
    stage = page.get_by_role("application")
    expect(stage).to_be_visible()
    page.get_by_role("button", name="Without a headset").click()
    panel = page.get_by_role("region", name="What the person sees on the panel")
    expect(panel.get_by_role("button", name="Start")).to_be_visible()
    stage.locator("canvas").hover(position={"x": 300, "y": 200})

    def hand(side: str = "right") -> dict[str, Any] | None:
        return (patient(cell).get("hands") or {}).get(side)

    def hand_is_at(reached: Callable[[list[float]], bool]) -> Callable[[], bool]:
        return lambda: (now := hand()) is not None and reached(now["position"])

    found = wait_for(hand, WITHIN_S, "a hand")
    first = found["position"]
    stage.locator("canvas").hover(position={"x": 380, "y": 200})
    wait_for(hand_is_at(lambda place: place[1] > first[1] + 0.02), WITHIN_S, "it moves")
    stage.locator("canvas").hover(position={"x": 300, "y": 200})
    page.mouse.wheel(0, -300)
    wait_for(hand_is_at(lambda place: place[0] < first[0] - 0.01), WITHIN_S, "deeper")
    page.mouse.down()
    wait_for(lambda: (hand() or {}).get("grip") == 1, WITHIN_S, "it closes")
    page.mouse.up()
    stage.focus()
    page.keyboard.press("Home")
    page.keyboard.press("ArrowUp")
    wait_for(lambda: hand("left") is not None, WITHIN_S, "the other hand")

    wait_for(lambda: state(cell)["phase"] == "standing", WITHIN_S, "it stands")
    panel.get_by_role("button", name="Start").click()
    wait_for(lambda: session(cell).get("state") in {"running", "paused"}, WITHIN_S, "a session")
    identity = session(cell)["id"]
    keep(page, "humanoid-vr-pointer")
    accessible(page)

    def is_paused() -> bool:
        now = session(cell)
        if now["state"] == "running":
            with suppress(Error):  # it has just paused for silence, and the button has gone
                panel.get_by_role("button", name="Pause").click(timeout=1000 * scaled(2))
        elif "person" not in now["pauseReason"]:  # for silence, on a slow machine
            httpx.post(f"{cell.url(SERVICE)}/sessions/{identity}/resume", timeout=120)
        return "person" in session(cell)["pauseReason"]

    wait_for(is_paused, WITHIN_S, "the panel pauses")

    def runs() -> bool:
        if session(cell)["state"] == "paused":
            with suppress(Error):
                panel.get_by_role("button", name="Resume").click(timeout=1000 * scaled(2))
        return bool(session(cell)["state"] == "running")

    wait_for(runs, WITHIN_S, "it continues")
    panel.get_by_role("button", name="Leave").click()
    wait_for(lambda: session(cell)["state"] == "paused", WITHIN_S, "leaving pauses")
    expect(panel).to_be_hidden()


def test_a_person_with_a_headset_catches_a_ball_and_a_lost_tracking_pauses_the_session(
    cell: Cell, open_page: OpenPage, keep: Callable[[Page, str], Path]
) -> None:
    page = open_page("/", viewport=SMALL, forgives=("XRSession", "already", "status of 502"))
    page.add_init_script(f"{EMULATOR.read_text()}\n{WEAR}")
    page.goto("/care/exercises/vr")
    expect(page.get_by_role("application")).to_be_visible()
    page.get_by_text("Measure", exact=True).click()
    page.get_by_role("button", name="Enter virtual reality").click()

    wait_for(lambda: patient(cell).get("tracking") == "ok", WITHIN_S, "the poses reach the service")
    head = headset(cell)["position"]
    base = state(cell)["base"]
    assert abs(head[0] - base[0] - 1.15) < 0.05  # at the seat, whatever place in the room that is
    assert abs(head[1] - base[1]) < 0.05
    assert abs(head[2] - 1.15) < 0.05
    hands = wait_for(lambda: patient(cell).get("hands"), WITHIN_S, "the hands reach the service")
    right, left = (hands[side]["position"] for side in ("right", "left"))
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


def test_a_therapist_chooses_the_landing_and_a_person_leads_the_robot_by_tracked_hands(
    cell: Cell, open_page: OpenPage, keep: Callable[[Page, str], Path]
) -> None:
    page = open_page("/", viewport=SMALL, forgives=("XRSession", "already", "status of 409", "status of 502"))
    page.set_default_timeout(1000 * WITHIN_S)
    page.add_init_script(f"{EMULATOR.read_text()}\n{WEAR}")
    page.goto("/care/exercises/vr")
    expect(page.get_by_role("application")).to_be_visible()
    page.get_by_role("button", name="Enter virtual reality").click()
    wait_for(lambda: patient(cell).get("tracking") == "ok", WITHIN_S, "the poses reach the service")
    wearer = Wearer(page)
    expect(wearer.panel.get_by_role("button", name="Start")).to_be_visible()

    wait_for(lambda: state(cell)["phase"] == "standing", WITHIN_S, "it stands")
    post(cell, "behaviour", behaviour="juggling")
    wearer.choose("Choose the target")
    expect(wearer.panel).to_contain_text("Choose where the ball lands")
    target = (0.8, 0.1, 0.6)
    wearer.point_at(in_room(target))
    expected = in_stance(cell, target)
    number = None

    def is_thrown() -> bool:  # the hand keeps the ball when wishes are late on a slow machine: throw again
        nonlocal number
        now = state(cell)
        if number is None or now["t"] - number > THROW_S:
            number = now["t"]
            wearer.press("trigger")
        return THROWN_MS in page.evaluate("pulses")

    wait_for(is_thrown, WITHIN_S, "the throw is felt")
    reached = state(cell)["throw"]["target"]
    assert np.hypot(reached[0] - expected[0], reached[1] - expected[1]) < 0.05
    assert reached[2] == pytest.approx(target[2])  # the ray met the plane of the chosen height

    wait_for(
        lambda: (
            httpx.post(f"{cell.url(SERVICE)}/behaviour", json={"behaviour": "walking"}).status_code == 200
        ),
        WITHIN_S,
        "it stands after the throw",
    )
    begun = post(cell, "sessions", application="walking", goal={"seconds": 600})
    expect(wearer.panel).to_contain_text("Hold the hands of the robot")
    page.evaluate("headset.primaryInputMode = 'hand'")
    wait_for(lambda: has_both_hands(cell), WITHIN_S, "the hands are tracked")

    def lead(ahead_m: float) -> bool:
        """Take the hands of the robot where they are, and draw them; return whether the robot walks so."""
        if session(cell)["state"] == "paused":  # for silence, on a slow machine
            httpx.post(f"{cell.url(SERVICE)}/sessions/{begun['id']}/resume", timeout=120)
        page.evaluate(PINCH, 0)
        page.evaluate(FRAMES)
        places = robot_hands(cell)
        for pulled_m in (0.0, 0.5 * ahead_m, ahead_m):  # a hand that is torn away at once holds nothing
            for side, of_robot in (("left", "right"), ("right", "left")):
                ahead, left, up = places[of_robot]
                page.evaluate(PUT_HAND, [side, in_room((ahead + pulled_m, left, up))])
            page.evaluate(FRAMES)
            page.evaluate(PINCH, 1)
            page.evaluate(FRAMES)
        begun_s = state(cell)["t"]
        wait_for(lambda: has_walked() or state(cell)["t"] > begun_s + 4, WITHIN_S)
        return has_walked()

    before = state(cell)["base"][0]

    def has_walked() -> bool:
        return bool(state(cell)["base"][0] > before + 0.06)

    wait_for(lambda: lead(0.2), WITHIN_S, "the robot walks where the hands lead it")
    assert session(cell)["distanceM"] > 0.03
    hands = wait_for(lambda: patient(cell).get("hands"), WITHIN_S, "the hands reach the service")
    assert 1.0 in {hand["grip"] for hand in hands.values()}  # the other one may have been torn off
    keep(page, "humanoid-vr-led")
    page.evaluate(PINCH, 0)

    page.evaluate("headset.primaryInputMode = 'controller'")
    wait_for(lambda: has_both_hands(cell), WITHIN_S, "the controllers are back")

    def runs() -> bool:
        if session(cell)["state"] == "paused":
            wearer.try_to_choose("Resume")
        return bool(session(cell)["state"] == "running")

    wait_for(runs, WITHIN_S, "the session runs")

    def is_paused() -> bool:
        if session(cell)["state"] == "running":
            wearer.press("a-button")
        return bool(session(cell)["state"] == "paused")

    wait_for(is_paused, WITHIN_S, "a button of the controller pauses")
    expect(wearer.panel).to_contain_text("Paused")
    wait_for(runs, WITHIN_S, "the ray at the panel resumes")

    page.evaluate("headset.position.set(1.3, 1.15, 2.2)")
    wearer.press("b-button")

    def is_at_seat() -> bool:
        now = state(cell)
        head = (now["patient"] or {}).get("headset")
        if head is None:
            return False
        away = np.hypot(head["position"][0] - now["base"][0], head["position"][1] - now["base"][1])
        return bool(abs(away - 1.15) < 0.08)

    wait_for(is_at_seat, WITHIN_S, "recentred")
    post(cell, f"sessions/{begun['id']}/end")
    # While it is led, a hand closes only around one of its hands.
    wait_for(
        lambda: (
            httpx.post(f"{cell.url(SERVICE)}/behaviour", json={"behaviour": "juggling"}).status_code == 200
        ),
        WITHIN_S,
        "it stands, and is led no more",
    )
