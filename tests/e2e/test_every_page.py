"""Every page in both themes, three languages and all sizes: nothing truncated, no axe violations."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

SIZES = {"panel": {"width": 1280, "height": 800}, "desk": {"width": 1920, "height": 1080}}
PHONE = {"width": 390, "height": 844}
TABLET = {"width": 820, "height": 1180}
COLLIDING = """
    [...document.querySelectorAll("main :is([role=cell], [role=gridcell], [role=columnheader], th)")]
        .filter((cell) => cell.offsetParent !== null && cell.clientWidth > 1)
        .filter((cell) => (cell.closest("thead")?.clientWidth ?? 2) > 1)
        .filter((cell) => {
            const [row, own] = [cell.closest("[role=row], tr"), cell.getBoundingClientRect()];
            const isBeyond = row !== null && own.right > row.getBoundingClientRect().right + 1;
            return isBeyond || cell.scrollWidth > cell.clientWidth + 1;
        })
        .map((cell) => `${cell.textContent.slice(0, 40)}: ${cell.scrollWidth} in ${cell.clientWidth} px`)
"""
"""The cells of tables whose content is wider than they are, but for heads that only screen readers see."""
LOOKS = [("light", "en", "panel"), ("dark", "de", "panel"), ("light", "fi", "desk"), ("dark", "en", "desk")]
PAGES = {
    "start": "/",
    "work": "/work",
    "processes": "/processes",
    "tasks": "/tasks",
    "cockpit": "/cockpit",
    "system": "/system",
    "calibrate": "/calibrate",
    "people": "/people",
    "test": "/test",
    "study": "/study",
}


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests: they only look."""
    return shared_cell


def settled(page: Page) -> None:
    """Wait until the page shows what it has to show."""
    page.locator("main h1, main h2").first.wait_for()
    page.evaluate("document.fonts.ready.then(() => true)")


def nothing_is_cut_off(page: Page) -> None:
    """Check that the page needs no scrolling sideways."""
    wider_by = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert wider_by <= 0, f"the page is {wider_by} px wider than the screen"


@pytest.mark.usefixtures("screen")
def test_pages_fit_and_are_accessible_in_all_themes_languages_and_sizes(
    open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    for theme, language, size in LOOKS:
        page = open_page(theme=theme, language=language, viewport=SIZES[size])
        for name, path in PAGES.items():
            page.goto(path)
            settled(page)
            assert page.locator("html").get_attribute("lang") == language
            nothing_is_cut_off(page)
            accessible(page)
            keep(page, f"{name}-{size}-{theme}-{language}")
        page.context.close()


@pytest.mark.usefixtures("screen")
def test_engineer_pages_fit_a_phone(
    open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    page = open_page(viewport=PHONE, has_touch=True, is_mobile=True)
    for path in ("/", "/system", "/calibrate", "/people", "/test", "/study"):
        page.goto(path)
        settled(page)
        nothing_is_cut_off(page)
        accessible(page)
        keep(page, f"phone{path.replace('/', '-')}")


@pytest.mark.usefixtures("screen")
def test_tables_do_not_overlap_on_a_tablet(open_page: OpenPage, keep: Callable[[Page, str], Path]) -> None:
    for language in ("fi", "de"):
        page = open_page(language=language, viewport=TABLET)
        for tab in ("services", "devices", "alerts"):
            page.goto(f"/system?tab={tab}")
            page.locator("[role=row], .empty-state").first.wait_for()
            nothing_is_cut_off(page)
            assert page.evaluate(COLLIDING) == []
            keep(page, f"tablet-{tab}-{language}")
        page.goto("/processes")
        settled(page)
        nothing_is_cut_off(page)
        keep(page, f"tablet-processes-{language}")
        page.goto("/")
        settled(page)
        nothing_is_cut_off(page)
        keep(page, f"tablet-start-{language}")
        page.context.close()


@pytest.mark.usefixtures("screen")
def test_table_rows_are_tab_stops_and_their_times_are_not(open_page: OpenPage) -> None:
    page = open_page("/system")
    rows = page.get_by_role("grid", name="Services").locator(".vgrid__line")
    rows.first.wait_for()
    assert page.locator("time[tabindex='0']").count() == 0
    assert page.locator("[role=row][tabindex='0']").count() == 1
    rows.first.focus()
    page.keyboard.press("ArrowDown")
    expect(rows.nth(1)).to_be_focused()
    shown = rows.nth(1).locator("time").first.evaluate("time => getComputedStyle(time, '::after').content")
    assert str(datetime.now(UTC).year) in shown, "the row with the focus shows the exact time"


@pytest.mark.usefixtures("screen")
def test_first_steps_are_dismissed_and_shown_on_request(open_page: OpenPage) -> None:
    page = open_page("/")
    steps = page.get_by_role("heading", name="Connect a glove")
    expect(steps).to_be_visible()
    page.get_by_role("button", name="Hide").click()
    expect(steps).to_have_count(0)
    page.reload()
    expect(page.get_by_role("region", name="Open tasks")).to_be_visible()
    expect(steps).to_have_count(0)
    page.get_by_role("button", name="Show first steps").click()
    expect(steps).to_be_visible()


@pytest.mark.usefixtures("screen")
def test_language_theme_and_name_are_stored(open_page: OpenPage) -> None:
    page = open_page("/", who="")
    page.get_by_role("button", name="Appearance, language and name").click()
    page.get_by_role("radio", name="Suomi").click()
    page.get_by_role("radio", name="Tumma").click()
    page.get_by_role("textbox", name="Nimi").fill("Aino")
    page.get_by_role("button", name="Sulje").click()
    page.reload()
    settled(page)
    assert page.locator("html").get_attribute("lang") == "fi"
    assert page.locator("html").get_attribute("data-theme") == "dark"
    page.get_by_role("button", name="Ulkoasu, kieli ja nimi").click()
    assert page.get_by_role("textbox", name="Nimi").input_value() == "Aino"


@pytest.mark.usefixtures("screen")
def test_the_keyboard_reaches_every_page_and_lists_its_keys(open_page: OpenPage) -> None:
    page = open_page("/")
    settled(page)
    for key, path in (("2", "/work"), ("3", "/processes"), ("4", "/system"), ("1", "/")):
        page.keyboard.press(key)
        page.wait_for_url(f"**{path}*")
    page.keyboard.press("?")
    page.get_by_role("dialog", name="Keyboard shortcuts").wait_for()
    page.keyboard.press("Escape")
    page.get_by_role("dialog").wait_for(state="detached")


@pytest.mark.usefixtures("screen")
def test_nothing_is_loaded_from_other_hosts(open_page: OpenPage) -> None:
    fetched: set[str] = set()
    page = open_page("/")
    page.on("request", lambda request: fetched.add(request.url))
    for path in PAGES.values():
        page.goto(path)
        settled(page)
    ours = page.url.split("/")[2]
    elsewhere = {
        url for url in fetched if url.split("/")[2] != ours and not url.startswith(("data:", "blob:"))
    }
    assert not elsewhere
