"""A browser for tests of the page: Debian's Chromium, and pages that fail a test on any error."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

from handover_datamodels.times import iso
from tests.kit.cell import Cell
from tests.kit.chromium import FLAGS, chromium
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import wait_for

SCREENSHOTS = REPOSITORY / "build" / "screenshots"
"""Where the pictures of a run stay, to be looked at."""

EXAMPLES = sorted(path.parent for path in (REPOSITORY / "examples").glob("*/pyproject.toml"))

STILL = "Promise.allSettled(document.getAnimations().map((motion) => motion.finished)).then(() => true)"
PANEL = {"width": 1280, "height": 800}

APPEARS = """(text) => {
  const appeared = (window.appeared ??= new Set());
  appeared.delete(text);
  const observer = new MutationObserver(() => {
    if (!document.body.textContent.includes(text)) return;
    appeared.add(text);
    observer.disconnect();
  });
  observer.observe(document.body, { childList: true, characterData: true, subtree: true });
}"""

PERSON_MS = 200
"""How far apart a person presses keys."""

TIMEOUT_MS = 90_000
"""How long a test waits for an element or a state: long, since a slow machine is no reason to fail."""

expect.set_options(timeout=TIMEOUT_MS)

OpenPage = Callable[..., Page]

SCAN_GAP_S = 0.02
"""How far apart a scanner types its characters."""


def scan(page: Page, text: str) -> None:
    """Type `text` and Enter as a bar-code scanner does.

    The events carry their own times, so that a slow machine does not turn a scan into what a person types.
    """
    devtools = page.context.new_cdp_session(page)
    at = time.time()
    for number, key in enumerate([*text, "Enter"]):
        typed = "\r" if key == "Enter" else key
        for kind in ("keyDown", "keyUp"):
            stamp = at + number * SCAN_GAP_S + (0.004 if kind == "keyUp" else 0)
            code = 13 if key == "Enter" else ord(key.upper())
            event: dict[str, Any] = {
                "type": kind,
                "key": key,
                "timestamp": stamp,
                "windowsVirtualKeyCode": code,
            }
            if kind == "keyDown":
                event["text"] = typed
            devtools.send("Input.dispatchKeyEvent", event)
    devtools.detach()


def type_slowly(page: Page, *keys: str) -> None:
    """Press keys one after the other as a person does, far enough apart that they are no scan.

    A character that no key of Playwright's keyboard has, such as "ö", is inserted.
    """
    for key in keys:
        page.wait_for_timeout(PERSON_MS)
        if len(key) == 1:
            page.keyboard.type(key)
        else:
            page.keyboard.press(key)


def answer(cell: Cell, task: str, status: str, **outputs: Any) -> None:
    """Answer a Task as its performer would, in the broker."""
    entity = f"{cell.url('context_broker')}/ngsi-ld/v1/entities/{task}"
    # Its own performer takes it up first, and would write over what was answered before that.
    wait_for(lambda: '"inProgress"' in httpx.get(entity, timeout=120).text)
    stamp = iso(datetime.now(UTC))
    body = {
        "status": {"type": "Property", "value": status, "observedAt": stamp},
        "outputParameters": {"type": "Property", "value": outputs, "observedAt": stamp},
    }
    httpx.post(f"{entity}/attrs", json=body, timeout=120).raise_for_status()


@contextmanager
def appearing(page: Page, text: str) -> Iterator[None]:
    """Expect that what is done in the block lets `text` appear, even if it is gone before anybody looks."""
    page.evaluate(APPEARS, text)
    yield
    page.wait_for_function("(text) => window.appeared.has(text)", arg=text)


@pytest.fixture(scope="module")  # while Playwright is there, its loop runs and no other test may run one
def browser() -> Iterator[Browser]:
    """Chromium without a window; skips where none is installed."""
    program = chromium()
    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
        yield launched
        launched.close()


@pytest.fixture
def screen(cell: Cell) -> Cell:
    """A cell with every service and the screen; a module whose tests share a cell shares what runs in it."""
    cell.run("context_broker")
    cell.run("task_orchestrator", "gesture_controller", "trajectory_tool", "study", "webui")
    return cell


@pytest.fixture
def quiet_screen(screen: Cell) -> Cell:
    """A screen at which nobody is asked for anything: what tests before have begun is cancelled."""
    processes = f"{screen.url('task_orchestrator')}/processes"
    for process in httpx.get(processes, params={"status": "inProgress"}, timeout=120).json():
        httpx.post(f"{processes}/{process['id']}/cancel", timeout=120).raise_for_status()
    for busy in (
        f"{screen.url('gesture_controller')}/gloves/glove-1",
        f"{screen.url('trajectory_tool')}/robots/ur10-1",
    ):
        wait_for(lambda busy=busy: httpx.get(busy, timeout=120).json()["task"] is None)  # type: ignore[misc]
    running = {"status": "inProgress"}  # until it has ended, a process keeps the robot that it has reserved
    wait_for(lambda: httpx.get(processes, params=running, timeout=120).json() == [])
    return screen


@pytest.fixture
def glove_screen(cell: Cell) -> Cell:
    """A cell with the screen and what gloves need, but no processes and no robot."""
    cell.run("context_broker")
    cell.run("gesture_controller", "study", "webui")
    return cell


@pytest.fixture
def open_page(browser: Browser, cell: Cell) -> Iterator[OpenPage]:
    """Open pages of the cell's screen; a page that logs an error or throws fails the test at its end.

    `forgives` are parts of messages that the test itself provokes, such as a service it has killed.
    """
    faults: list[str] = []
    forgiven: list[str] = []

    def note(fault: str) -> None:
        if not any(part in fault for part in forgiven):
            faults.append(fault)

    with ExitStack() as contexts:

        def open_one(
            path: str = "/",
            *,
            language: str = "en",
            theme: str = "light",
            viewport: dict[str, int] | None = None,
            who: str = "Anna",
            forgives: tuple[str, ...] = (),
            **options: Any,
        ) -> Page:
            forgiven.extend(forgives)
            context = browser.new_context(
                base_url=cell.url("webui"),
                viewport=viewport or PANEL,
                color_scheme=theme,
                locale={"en": "en-GB", "de": "de-DE", "fi": "fi-FI"}[language],
                **options,
            )
            contexts.callback(context.close)
            context.set_default_timeout(TIMEOUT_MS)
            if who:
                context.add_init_script(f"localStorage.setItem('handover.who', {who!r})")
            page = context.new_page()
            page.on("pageerror", lambda error: note(f"thrown: {error}"))
            page.on("console", lambda line: note(f"logged: {line.text}") if line.type == "error" else None)
            page.goto(path)
            return page

        yield open_one
    assert not faults, "\n".join(faults)


@pytest.fixture
def keep() -> Callable[[Page, str], Path]:
    """Keep a picture of a page under a name."""

    def take(page: Page, name: str) -> Path:
        path = SCREENSHOTS / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        page.screenshot(path=path)
        return path

    return take


@pytest.fixture
def accessible() -> Callable[[Page], None]:
    """Check a page with axe: nothing serious or critical."""
    axe = (REPOSITORY / "webui" / "app" / "node_modules" / "axe-core" / "axe.min.js").read_text()

    def check(page: Page) -> None:
        page.evaluate(STILL)  # what still slides in is paler than it will be
        page.evaluate(axe)
        found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
        serious = [
            f"{violation['id']} ({violation['impact']}): {violation['help']}\n    "
            + "\n    ".join(
                node["html"][:200] + " " + " ".join(node["target"]) + " " + node["failureSummary"][:300]
                for node in violation["nodes"]
            )
            for violation in found["violations"]
            if violation["impact"] in {"serious", "critical"}
        ]
        assert not serious, "\n".join(serious)

    return check


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all examples installed."""
    folder = tmp_path_factory.mktemp("installed")
    install = [sys.executable, "-m", "uv", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    python = ["--python", sys.executable, "--target", str(folder)]
    subprocess.run([*install, *python, *map(str, EXAMPLES)], check=True)
    return folder


@pytest.fixture
def extended_cell(cell: Cell, installed: Path) -> Cell:
    """A cell whose processes find the installed examples."""
    cell.extra["PYTHONPATH"] = str(installed)
    return cell
