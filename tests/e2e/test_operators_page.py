"""The bin-picking process from the Work page: keyboard only, mouse only, glove only."""

import contextlib
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Error, Page, expect

from tests.e2e.conftest import OpenPage, appearing, type_slowly
from tests.kit.cell import Cell

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

WORK = "/work?glove=glove-1"
NOTHING_RUNS = "[data-situation=idle], [data-situation=completed]"
"""What the page shows before a process, and after one that another test has completed."""


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests. A glove that was worn in it is lost: those who wear one come last."""
    return shared_cell


def completed_by(cell: Cell) -> list[tuple[str, str]]:
    """How and by whom each Task of the operator was completed in the last process, a completed one."""
    orchestrator = cell.url("task_orchestrator")
    last = httpx.get(f"{orchestrator}/processes", timeout=120).json()[0]["id"]
    process = httpx.get(f"{orchestrator}/processes/{last}", timeout=120).json()
    assert process["status"] == "completed", process
    outputs = [task["outputParameters"] for task in process["tasks"]]
    return [(each["by"], each.get("operator", "")) for each in outputs if "by" in each]


def until_done(page: Page, act: Callable[[], None]) -> None:
    """Do `act` whenever the operator is asked, until the process is completed."""
    stage = page.locator("[data-situation]")
    for _ in range(400):
        match stage.get_attribute("data-situation"):
            case "completed":
                return
            case "prompt":
                act()
            case "failed" | "incident" | "serviceLost" | "linkLost":
                pytest.fail(page.locator("main").inner_text())
            case _:
                page.wait_for_timeout(250)
    pytest.fail(f"the process did not end: {page.locator('main').inner_text()}")


@pytest.mark.nightly
@pytest.mark.usefixtures("quiet_screen")
def test_with_the_keyboard_only(
    cell: Cell, open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    page = open_page(WORK, who="")
    page.locator(NOTHING_RUNS).wait_for()
    accessible(page)
    keep(page, "work-idle")

    def press(name: str) -> None:
        """Reach the button by Tab, and press it."""
        button = page.get_by_role("button", name=name, exact=True)
        expect(button).to_be_enabled()
        for _ in range(60):
            page.keyboard.press("Tab")
            if button.evaluate("one => one === document.activeElement"):
                break
        type_slowly(page, "Enter")

    type_slowly(page, "s", "Enter", "c", " ")  # keys that nothing has the focus for
    page.locator(NOTHING_RUNS).wait_for()
    press("Start Bin picking")
    page.get_by_role("heading", name="Confirm that nobody").wait_for()
    accessible(page)
    keep(page, "work-asked")
    page.evaluate("document.activeElement.blur()")
    type_slowly(page, "c", "Enter", " ", "p", "n", "b")
    expect(page.get_by_role("dialog")).to_have_count(0)
    press("Complete by hand")
    page.get_by_role("dialog", name="Who are you?").wait_for()
    with appearing(page, "Completed by Aino"):
        type_slowly(page, *"Aino", "Enter")

    def answer() -> None:
        with contextlib.suppress(AssertionError, Error):  # the step may be over
            press("Complete by hand")
        page.wait_for_timeout(400)

    keep(page, "work-answered")
    until_done(page, answer)
    keep(page, "work-completed")
    assert set(completed_by(cell)) == {("screen", "Aino")}


@pytest.mark.nightly
@pytest.mark.usefixtures("quiet_screen")
def test_with_the_mouse_only(
    cell: Cell, open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    page = open_page("/work")
    page.get_by_role("button", name="Start bin picking").click()
    page.get_by_role("heading", name="Confirm that nobody").wait_for()
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("heading", name="Paused").wait_for()
    keep(page, "work-paused")
    page.get_by_role("button", name="Resume").first.click()
    page.locator("[data-situation='prompt']").wait_for()
    seen_at_work = False

    def answer() -> None:
        nonlocal seen_at_work
        with appearing(page, "Completed by Anna"):
            page.get_by_role("button", name="Complete by hand").click()
        with contextlib.suppress(Exception):  # a step of the robot may be over before it is looked at
            page.get_by_text("Keep out of the cell").wait_for(timeout=5_000)
            keep(page, "work-robot")
            seen_at_work = True

    until_done(page, answer)
    assert seen_at_work
    accessible(page)
    assert set(completed_by(cell)) == {("screen", "Anna")}


@pytest.mark.nightly
@pytest.mark.parametrize(
    "lost",
    [
        ("context_broker", "Context broker not responding"),
        ("gesture_controller", "Gesture controller not responding"),
        ("webui", "No connection to the cell"),
    ],
)
@pytest.mark.usefixtures("quiet_screen")
def test_lost_components_are_named_and_recover_while_the_page_is_open(
    cell: Cell,
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
    lost: tuple[str, str],
) -> None:
    service, title = lost
    page = open_page(WORK, forgives=("WebSocket connection", "Failed to load resource"))
    page.get_by_role("button", name="Start Bin picking").click()
    page.get_by_role("heading", name="Confirm that nobody").wait_for()
    cell.kill(service)
    page.get_by_role("heading", name=title).wait_for(timeout=120_000)
    accessible(page)
    keep(page, f"work-without-{service}")
    cell.start(service)
    page.get_by_role("heading", name="Confirm that nobody").wait_for(timeout=120_000)
    with appearing(page, "Completed by Anna"):
        page.get_by_role("button", name="Complete by hand").click()


class Wearer:
    """Somebody with glove-1 on: 50 frames a second of whatever the hand shows, at the shipped thresholds."""

    STRAIGHT, BENT = (1100, 1700, 1700, 1900, 2000), (700, 700, 400, 700, 800)

    def __init__(self, port: int) -> None:
        self._link = socket.create_connection(("127.0.0.1", port), timeout=120)
        self._say({"type": "hello", "version": 1, "glove": "glove-1", "hand": "right"})
        assert b'"ack"' in self._link.recv(4096)
        self._code = "22222"
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._move)
        self._thread.start()

    def show(self, code: str) -> None:
        """Make a hand of five finger states."""
        self._code = code

    def take_off(self) -> None:
        """Take the glove off."""
        self._stop.set()
        self._thread.join()
        self._link.close()

    def _move(self) -> None:
        seq = 0
        while not self._stop.wait(0.02):
            seq += 1
            hands = zip(self._code, self.STRAIGHT, self.BENT, strict=True)
            bend = [straight if finger == "0" else bent for finger, straight, bent in hands]
            self._say({"type": "frame", "seq": seq, "t": time.monotonic(), "bend": bend, "pressure": [0] * 5})

    def _say(self, message: dict[str, Any]) -> None:
        self._link.sendall(json.dumps(message).encode() + b"\n")


@pytest.fixture
def put_on(cell: Cell) -> Iterator[Callable[[], Wearer]]:
    """Let somebody put on glove-1."""
    wearers: list[Wearer] = []

    def put_on() -> Wearer:
        wearers.append(Wearer(cell.ports["glove"]))
        return wearers[-1]

    yield put_on
    for wearer in wearers:
        wearer.take_off()


@pytest.mark.usefixtures("quiet_screen")
def test_with_the_glove_only(
    cell: Cell,
    open_page: OpenPage,
    put_on: Callable[[], Wearer],
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
) -> None:
    gestures = {
        each["name"]: each["code"]
        for each in httpx.get(f"{cell.url('gesture_controller')}/gestures", timeout=120).json()
    }
    page = open_page(WORK)
    page.locator(NOTHING_RUNS).wait_for()
    wearer = put_on()
    page.get_by_text("Show Thumbs up to start Bin picking").wait_for()
    wearer.show("02222")
    page.get_by_role("heading", name="Confirm that nobody").wait_for()
    asked_wrong = False

    def answer() -> None:
        nonlocal asked_wrong
        wearer.show("22222")
        wanted = page.locator(".work__gesture").inner_text().removeprefix("Show").strip()
        if not asked_wrong:
            asked_wrong = True
            wearer.show("20220")  # Horns: the page says which fingers differ, and nothing counts
            page.get_by_text("That is Horns").wait_for()
            accessible(page)
            keep(page, "work-wrong-gesture")
        with appearing(page, "Confirmed"):  # for 1.2 s, which a picture may take
            with appearing(page, "Right. Hold it"):
                wearer.show(gestures[wanted])
            keep(page, "work-hold")
        wearer.show("22222")

    page.wait_for_timeout(300)
    until_done(page, answer)
    wearer.show("22222")
    keep(page, "work-completed-dark")
    assert {by for by, _ in completed_by(cell)} == {"gesture"}


@pytest.mark.nightly
@pytest.mark.usefixtures("quiet_screen")
def test_a_lost_glove_fills_the_page_until_it_reconnects(
    open_page: OpenPage,
    put_on: Callable[[], Wearer],
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
) -> None:
    wearer = put_on()
    page = open_page(WORK)
    page.get_by_text("Show Thumbs up to start Bin picking").wait_for()
    wearer.show("02222")
    page.get_by_role("heading", name="Confirm that nobody").wait_for()
    wearer.take_off()
    page.get_by_role("heading", name="Connection to glove-1 lost").wait_for()
    accessible(page)
    keep(page, "work-glove-lost")
    page.get_by_role("button", name="Complete by hand").wait_for()
    put_on()
    page.get_by_role("heading", name="Confirm that nobody").wait_for()
