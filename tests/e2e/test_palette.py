"""The command palette in Chromium: a process is found and opened, an act asks, a viewer is offered no act."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser as Chromium
from playwright.sync_api import Locator, Page, expect

from services.task_orchestrator.tests.unit.drawing import drawing, end, path, start
from tests.e2e.conftest import PANEL, SCREENSHOTS, TIMEOUT_MS, OpenPage
from tests.kit.cell import Cell, new_cell
from webui.tests.integration.test_signing_in import PASSWORD, Browser, invited, set_up

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

Keep = Callable[[Page, str], Path]
Accessible = Callable[[Page], None]

TITLE = "Prüfung am Eingang"
INSPECTION = drawing(
    start() + '<bpmn:userTask id="look" name="Look at the part"/>' + end() + path("start", "look", "end"),
    name="inspection",
).decode()
LOOKS = (
    ("light", {}),
    ("dark", {"theme": "dark"}),
    ("de", {"language": "de"}),
    ("fi-1366", {"language": "fi", "viewport": {"width": 1366, "height": 768}}),
    ("phone", {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}),
)


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests."""
    return shared_cell


def begin(cell: Cell) -> str:
    """Deploy and start the inspection; return the id of its process."""
    orchestrator = cell.url("task_orchestrator")
    content = INSPECTION.replace('id="inspection"', f'id="inspection" name="{TITLE}"')
    files = {"files": [{"name": "inspection.bpmn", "content": content}]}
    httpx.post(f"{orchestrator}/deployments", json=files, timeout=120).raise_for_status()
    body = {"definition": "inspection", "key": "order-7"}
    started = httpx.post(f"{orchestrator}/processes", json=body, timeout=120)
    return str(started.raise_for_status().json()["id"])


def palette(page: Page) -> Locator:
    """Open the palette with its keys; return its field."""
    page.get_by_role("button", name="Search and commands Ctrl K").wait_for()
    page.keyboard.press("Control+k")
    field = page.get_by_role("combobox", name="Search and commands")
    expect(field).to_be_focused()
    return field


def option(page: Page, name: str | re.Pattern[str]) -> Locator:
    """What the palette lists under a name."""
    return page.get_by_role("listbox").get_by_role("option", name=name)


def test_a_process_is_found_opened_and_cancelled_with_its_question(
    quiet_screen: Cell, open_page: OpenPage, accessible: Accessible
) -> None:
    process = begin(quiet_screen)
    page = open_page("/cell")
    before = page.get_by_role("button", name="Appearance, language and name")
    before.focus()
    field = palette(page)
    field.fill("pruefung order")
    first = option(page, re.compile("order-7.*Running"))
    expect(first).to_have_attribute("aria-selected", "true")
    accessible(page)
    page.keyboard.press("Escape")
    expect(field).to_have_count(0)
    expect(before).to_be_focused()

    palette(page).fill("order-7")
    expect(first).to_be_visible()
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile(f"/processes/{process}$"))
    expect(page.get_by_role("main")).to_be_focused()

    before.focus()
    field = palette(page)
    expect(page.get_by_role("group", name="Recent").get_by_role("option").first).to_contain_text("order-7")
    field.fill("cancel order")
    expect(option(page, re.compile("^Cancel .*order-7 …"))).to_have_attribute("aria-selected", "true")
    page.keyboard.press("Enter")
    question = page.get_by_role("dialog", name=re.compile("^Cancel .*order-7"))
    expect(question).to_contain_text("cannot be resumed")
    url = f"{quiet_screen.url('task_orchestrator')}/processes/{process}"
    assert httpx.get(url, timeout=120).json()["status"] == "inProgress", "nothing happens without the answer"
    question.get_by_role("button", name=re.compile("^Cancel ")).click()
    expect(page.get_by_text(re.compile("^Done: Cancel .*order-7"))).to_be_visible()
    expect(before).to_be_focused()
    assert httpx.get(url, timeout=120).json()["status"] == "failed"


def test_settings_and_moves_of_the_cursor(quiet_screen: Cell, open_page: OpenPage) -> None:
    page = open_page("/")
    palette(page).fill("dark")
    expect(option(page, "Appearance: Dark")).to_have_attribute("aria-selected", "true")
    page.keyboard.press("Enter")
    expect(page.locator("html[data-theme=dark]")).to_have_count(1)
    field = palette(page)
    options = page.get_by_role("listbox").get_by_role("option")
    expect(options.first).to_have_attribute("aria-selected", "true")
    page.keyboard.press("ArrowUp")
    expect(options.last).to_have_attribute("aria-selected", "true")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowDown")
    expect(options.nth(1)).to_have_attribute("aria-selected", "true")
    field.press_sequentially("keyboard sh", delay=100)
    expect(option(page, "Show keyboard shortcuts")).to_have_attribute("aria-selected", "true")
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog", name="Keyboard shortcuts")).to_contain_text("Ctrl")
    page.keyboard.press("Control+k")
    expect(page.get_by_role("combobox", name="Search and commands")).to_have_count(0)


@pytest.mark.nightly
def test_the_palette_in_each_look(
    quiet_screen: Cell,
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Accessible,
) -> None:
    begin(quiet_screen)
    for name, look in LOOKS:
        page = open_page("/", **look)
        page.locator(".palette-button button").wait_for()
        keep(page, f"palette-{name}-button")
        page.locator(".palette-button button").click()
        page.get_by_role("listbox").get_by_role("option").first.wait_for()
        keep(page, f"palette-{name}-start")
        page.get_by_role("combobox").fill("pr")
        option(page, re.compile("order-7")).first.wait_for()
        accessible(page)
        keep(page, f"palette-{name}")
        if name == "phone":
            box = page.get_by_role("option").first.bounding_box()
            assert box is not None
            assert box["height"] >= 64, "for gloved hands"
        page.get_by_role("option").first.click()
        expect(page.get_by_role("combobox")).to_have_count(0)


@pytest.fixture
def own_cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with new_cell(tmp_path_factory.mktemp("palette")) as made:
        made.start("context_broker", "accounts", "task_orchestrator", "webui", within_s=120)
        yield made


def test_a_viewer_finds_a_process_and_is_offered_no_act(browser: Chromium, own_cell: Cell) -> None:
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    begin(own_cell)
    owner = Browser(own_cell)
    body = {"link": set_up(own_cell), "name": "Olga", "password": PASSWORD}
    assert owner.begin("/api/session/link-use", body).status_code == 200
    invited(own_cell, owner, "Vera", {"role": "viewer", "resource": "*"})
    page = browser.new_page(viewport=PANEL, locale="en")
    page.set_default_timeout(TIMEOUT_MS)
    page.goto(own_cell.url("webui"))
    page.get_by_label("Name", exact=True).fill("Vera")
    page.get_by_label("Password", exact=True).fill(PASSWORD)
    page.get_by_role("button", name="Sign in").click()
    page.get_by_role("button", name="Account of Vera").wait_for()
    field = palette(page)
    field.fill("order-7")
    expect(option(page, re.compile("order-7.*Running"))).to_be_visible()
    for act in ("cancel", "pause", "start", "upload", "resume", "migrate"):
        field.fill(f"{act} ")
        expect(page.get_by_role("status").filter(has_text=re.compile("result"))).to_be_visible()
        expect(option(page, re.compile("…"))).to_have_count(0)
    field.fill("Olga")
    expect(page.get_by_text("Nothing is named “Olga”.")).to_be_visible()
    field.fill("sign out")
    page.screenshot(path=SCREENSHOTS / "palette-viewer.png")
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
    page.close()
