"""A person moves robots on the page Control, and every way to let go stops them."""

import math
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from handover_devices.device_client import DeviceClient
from tests.e2e.conftest import APPEARS, OpenPage
from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow]

FAKE_PAD = """
const buttons = Array.from({length: 17}, () => ({pressed: false}));
window.pad = {connected: true, axes: [0, 0, 0, 0], buttons};
navigator.getGamepads = () => [window.pad];
"""
CONTROL = "/cell/robots/ur10-1/control"
RELEASE = "Release the control once, then hold it again."


@pytest.fixture
def control(cell: Cell) -> Cell:
    cell.run("context_broker")
    cell.run("trajectory_tool", "device_gateway", "webui")
    # Without a graphics card the 3D view takes the time in which inputs have to be sent.
    store_layout(cell, {"side": "joints", "isViewFolded": True})
    return cell


@pytest.fixture
def gateway(control: Cell) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=control.url("device_gateway"), timeout=120, trust_env=False) as made:
        yield made


def layout_of(cell: Cell) -> str:
    return f"{cell.url('webui')}/api/user-settings/control.layout"


def store_layout(cell: Cell, layout: dict[str, object]) -> None:
    httpx.put(layout_of(cell), json=layout, timeout=120, trust_env=False).raise_for_status()


def joints(cell: Cell) -> dict[str, list[float]]:
    robot = httpx.get(f"{cell.url('trajectory_tool')}/robots/ur10-1", timeout=120, trust_env=False).json()
    found: dict[str, list[float]] = robot["joints"]
    return found


def rests(cell: Cell) -> bool:
    return not any(joints(cell)["velocity"])


def taken(page: Page) -> Page:
    page.get_by_role("button", name="Take control").click()
    expect(page.get_by_role("heading", name="You control ur10-1")).to_be_visible()
    return page


def moves(cell: Cell, page: Page, hold: Callable[[], None], release: Callable[[], None]) -> None:
    """Hold until the robot moves. A busy machine may delay inputs; the control has to be released then."""

    def is_moving() -> bool:
        if not rests(cell):
            return True
        release()
        page.wait_for_timeout(100)  # so that the release is sent
        before = joints(cell)["position"]
        hold()
        for _ in range(50):  # often, since the robot rests again after any 100 ms without an input
            page.wait_for_timeout(100)
            if not rests(cell):
                return True
        return joints(cell)["position"] != before  # it moved between two looks

    wait_for(is_moving)


def test_each_way_to_let_go_stops_the_robot(control: Cell, open_page: OpenPage) -> None:
    page = open_page(CONTROL)
    page.add_init_script(FAKE_PAD)
    page.reload()
    taken(page)

    def keys(*, down: bool) -> None:
        for key in ("KeyR", "Space"):
            page.keyboard.down(key) if down else page.keyboard.up(key)

    def pad(*, down: bool) -> None:
        page.evaluate("(down) => { pad.axes[3] = down ? 1 : 0; pad.buttons[5].pressed = down; }", down)

    moves(control, page, lambda: keys(down=True), lambda: keys(down=False))
    page.keyboard.up("Space")  # released; the key that moves is still pressed
    wait_for(lambda: rests(control))
    page.keyboard.up("KeyR")

    stick = page.get_by_role("img", name="Joystick: up, down").bounding_box()
    assert stick is not None
    x, y = stick["x"] + stick["width"] / 2, stick["y"] + stick["height"] / 2

    def drag() -> None:
        page.keyboard.down("Space")
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x, y - stick["height"] / 2)

    def let_go() -> None:
        page.mouse.up()
        page.keyboard.up("Space")

    moves(control, page, drag, let_go)
    page.evaluate("dispatchEvent(new Event('blur'))")
    wait_for(lambda: rests(control))
    let_go()

    moves(control, page, lambda: pad(down=True), lambda: pad(down=False))
    page.evaluate(
        "Object.defineProperty(document, 'hidden', {value: true, configurable: true});"
        "document.dispatchEvent(new Event('visibilitychange'));"
    )
    wait_for(lambda: rests(control))
    pad(down=False)

    moves(control, page, lambda: pad(down=True), lambda: pad(down=False))
    page.evaluate(
        "setTimeout(() => { const end = performance.now() + 2000; while (performance.now() < end); })"
    )
    expect(page.get_by_text(RELEASE)).to_be_visible()  # no message came for 100 ms; the stick is still held
    wait_for(lambda: rests(control))
    pad(down=False)
    page.get_by_role("button", name="End control").click()
    expect(page.get_by_role("heading", name="Nobody controls ur10-1")).to_be_visible()


def test_the_control_is_handed_over_and_taken_over(control: Cell, open_page: OpenPage) -> None:
    anna, ben = taken(open_page(CONTROL)), open_page(CONTROL, who="Ben")
    ben.get_by_role("button", name="Ask for control").click()
    anna.get_by_role("button", name=re.compile("Hand over to")).click()
    expect(ben.get_by_role("heading", name="You control ur10-1")).to_be_visible()
    expect(anna.get_by_text("You have handed over the control.")).to_be_visible()
    anna.get_by_role("button", name=re.compile("Take over from")).click()
    expect(anna.get_by_role("heading", name="You control ur10-1")).to_be_visible()
    expect(ben.get_by_text("The control was taken away")).to_be_visible()
    anna.get_by_role("button", name="End control").click()
    wait_for(lambda: rests(control))


def test_what_is_shown_beside_the_joints_is_kept_for_the_user(control: Cell, open_page: OpenPage) -> None:
    page = open_page(CONTROL)
    page.get_by_role("button", name="Show", exact=True).click()
    page.get_by_role("tab", name="Positions").click()

    def is_stored() -> bool:
        kept = httpx.get(layout_of(control), timeout=120, trust_env=False).json()
        return bool(kept == {"side": "presets", "isViewFolded": False})

    wait_for(is_stored, 180)
    other = open_page(CONTROL)  # another browser
    expect(other.get_by_role("button", name="Save position")).to_be_visible()
    other.get_by_role("tab", name="Joints").click()
    expect(other.locator(".joint-jog li")).to_have_count(6)


IS_ON_SCREEN = """(selectors) => selectors.flatMap((selector) => {
  const all = [...document.querySelectorAll(selector)];
  const isSeen = (element) => {
    const { left, right, top, bottom } = element.getBoundingClientRect();
    const [x, y] = [(left + right) / 2, (top + bottom) / 2];
    const edges = [[x, y], [left + 2, y], [right - 2, y], [x, top + 2], [x, bottom - 2]];
    return edges.every(([atX, atY]) => {
      const above = document.elementFromPoint(atX, atY);
      return above !== null && element.contains(above);
    });
  };
  const unseen = all.filter((element) => !isSeen(element));
  return all.length === 0 ? [selector] : unseen.map((element) => `${selector} ${element.textContent}`);
})"""
"""Those of some elements that are not as a whole on the screen, or covered."""

ON_ONE_SCREEN = [
    ".control__notice",
    ".lease .button",
    ".control__view",
    ".jog .joystick",
    ".jog .slider input",
    ".jog .button",
    ".joint-jog .hold-button",
    ".state__stops",
    ".delay__chart",
    ".delay dd",
    ".hold-bar__button",
    ".hold-bar p",
]


@pytest.mark.parametrize(
    ("width", "height"), [(1366, 768), (1920, 1080), (3840, 2160), (820, 1180), (390, 844), (844, 390)]
)
@pytest.mark.parametrize(("language", "theme"), [("en", "light"), ("de", "dark"), ("fi", "light")])
def test_the_control_is_on_one_screen_and_nothing_is_covered(
    *,
    control: Cell,
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
    width: int,
    height: int,
    language: str,
    theme: str,
) -> None:
    """From 1366 x 768 all of it is; a smaller screen scrolls its panels above the dead-man control."""
    store_layout(control, {"side": "joints", "isViewFolded": False})
    page = open_page(CONTROL, viewport={"width": width, "height": height}, language=language, theme=theme)
    page.locator(".joint-jog li").nth(5).wait_for()
    accessible(page)
    keep(page, f"control-{width}-{language}-{theme}")
    always = [".control__notice", ".hold-bar__button", ".hold-bar p"]
    assert page.evaluate(IS_ON_SCREEN, ON_ONE_SCREEN if width >= 1366 else always) == []
    for selector in ON_ONE_SCREEN:
        for part in page.locator(selector).all():
            part.scroll_into_view_if_needed()
        assert page.evaluate(IS_ON_SCREEN, always) == []
    scrolls = "document.documentElement.scrollHeight - innerHeight"
    assert page.evaluate(scrolls) <= 1
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    page.locator(".delay dd").last.scroll_into_view_if_needed()
    keep(page, f"control-{width}-{language}-{theme}-end")


def test_a_server_that_hangs_is_named_on_the_control_and_on_every_page(
    control: Cell, open_page: OpenPage, keep: Callable[[Page, str], Path]
) -> None:
    page, home = taken(open_page(CONTROL)), open_page("/cell/robots")
    old = page.get_by_text("No answer from the server. What is shown is old.")
    banner = home.get_by_text("The data shown may be out of date")
    expect(old).to_have_count(0)
    expect(banner).to_have_count(0)
    server = control.processes["webui"].pid
    os.kill(server, signal.SIGSTOP)
    try:
        expect(old).to_be_visible()
        keep(page, "control-old")
        expect(banner).to_be_visible()
    finally:
        os.kill(server, signal.SIGCONT)
    expect(old).to_have_count(0)
    expect(banner).to_have_count(0)


@contextmanager
def repeated(client: DeviceClient, send: Callable[[], None]) -> Iterator[None]:
    """Let a device send an input 100 times a second."""
    ended = threading.Event()

    def repeat() -> None:
        while not ended.wait(0.01):
            send()

    client.start()
    thread = threading.Thread(target=repeat)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        client.stop()


def test_the_position_of_a_hand_moves_the_tool(
    control: Cell, gateway: httpx.Client, open_page: OpenPage
) -> None:
    body = {"name": "mocap-1", "description": {"kind": "inputDevice", "title": "Motion capture"}}
    token = gateway.post("/devices", json=body).raise_for_status().json()["token"]
    client = DeviceClient("127.0.0.1", control.ports["devices"], "mocap-1", token)
    held = threading.Event()

    def wave() -> None:
        """Move a hand up and down by 10 cm, as motion capture sees it."""
        height = 0.05 * math.sin(2 * math.pi * time.monotonic() / 2)
        client.human_input({"handX": 0.4, "handY": 0.1, "handZ": 1.2 + height}, held.is_set())

    with repeated(client, wave):
        page = open_page(CONTROL)
        page.get_by_role("tab", name="Input devices").click()
        page.get_by_role("radio", name="Other device").click()
        page.get_by_text("Mapping", exact=True).click()
        page.get_by_role("radio", name="Positions of the hand").click()
        page.get_by_role("button", name="Drive ur10-1 with mocap-1").click()
        expect(page.get_by_text("ur10-1 is at rest")).to_be_visible()

        page.evaluate(APPEARS, "ur10-1 moves")

        def is_shown() -> bool:  # the page may miss a motion that a delayed input has ended
            moves(control, page, held.set, held.clear)
            page.wait_for_timeout(200)
            return bool(page.evaluate("() => window.appeared.has('ur10-1 moves')"))

        wait_for(is_shown)
        held.clear()
        wait_for(lambda: rests(control))
        page.get_by_role("button", name="End the control with mocap-1").click()
        expect(page.get_by_text("The last control has ended")).to_be_visible()
        page.reload()
        page.get_by_role("tab", name="Input devices").click()
        page.get_by_role("radio", name="Other device").click()
        page.get_by_text("Mapping", exact=True).click()
        expect(page.get_by_role("radio", name="Positions of the hand")).to_be_checked()
    gateway.delete("/devices/mocap-1").raise_for_status()


def test_a_glove_and_the_tilt_of_a_phone_move_the_tool(
    control: Cell, gateway: httpx.Client, open_page: OpenPage
) -> None:
    body = {"name": "glove-2", "description": {"kind": "inputDevice", "title": "Glove"}}
    token = gateway.post("/devices", json=body).raise_for_status().json()["token"]
    client = DeviceClient("127.0.0.1", control.ports["devices"], "glove-2", token)
    held = threading.Event()

    def bend() -> None:
        client.human_input({"thumbBend": 0.0, "indexBend": 0.8 if held.is_set() else 0.0}, held.is_set())

    with repeated(client, bend):
        page = open_page(CONTROL)
        page.get_by_role("tab", name="Input devices").click()
        page.get_by_role("radio", name="Other device").click()
        page.get_by_text("Mapping", exact=True).click()
        page.get_by_label("Up", exact=True).select_option(label="indexBend")
        page.get_by_role("button", name="Drive ur10-1 with glove-2").click()
        expect(page.get_by_text("ur10-1 is at rest")).to_be_visible()
        moves(control, page, held.set, held.clear)
        held.clear()
        wait_for(lambda: rests(control))
        page.get_by_role("button", name="End the control with glove-2").click()
        expect(page.get_by_text("The last control has ended")).to_be_visible()
    gateway.delete("/devices/glove-2").raise_for_status()

    phone = page.context.new_cdp_session(page)

    def tilt(beta: float) -> None:
        angles = {"alpha": 0, "beta": beta, "gamma": 0}
        phone.send("DeviceOrientation.setDeviceOrientationOverride", angles)

    tilt(40)
    page.get_by_role("tab", name="Input devices").click()
    page.get_by_role("radio", name="Tilt of this phone").click()
    page.get_by_role("button", name="Use the tilt of this device").click()
    expect(page.get_by_role("button", name="No longer use the tilt")).to_be_visible()
    taken(page)

    page.keyboard.down("Space")
    page.wait_for_timeout(1000)
    assert rests(control), "held at a tilt, and not moved by it"
    page.keyboard.up("Space")

    def hold_and_tilt() -> None:
        tilt(40)
        page.keyboard.down("Space")
        page.wait_for_timeout(200)  # so that the tilt is compared with that at which it was held
        tilt(10)

    moves(control, page, hold_and_tilt, lambda: page.keyboard.up("Space"))
    page.keyboard.up("Space")
    wait_for(lambda: rests(control))
