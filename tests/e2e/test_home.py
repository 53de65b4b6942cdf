"""Home: from an empty cell to a running process by the guide only, and what each role sees first."""

from collections.abc import Callable
from pathlib import Path

import httpx
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

LAPTOP = {"width": 1366, "height": 768}
PHONE = {"width": 390, "height": 844}
FULL_HD = {"width": 1920, "height": 1080}

Keep = Callable[[Page, str], Path]
Accessible = Callable[[Page], None]


def heads(page: Page) -> list[str]:
    """Return the titles of the sections, in the order of the document."""
    page.locator(".home__section h2").first.wait_for()
    return page.locator(".home__section h2").all_inner_texts()


def test_from_an_empty_cell_to_a_running_process_by_the_guide_only(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    cell.run("context_broker")
    cell.run("task_orchestrator", "gesture_controller", "trajectory_tool", "webui")
    page = open_page("/", viewport=LAPTOP)
    guide = page.get_by_role("region", name="First steps")
    expect(guide.get_by_role("heading", name="Connect a hand")).to_be_visible()
    keep(page, "home-first-run")
    accessible(page)
    guide.get_by_role("button", name="Try with a simulated hand").click()

    # The robot that is there is no step: it is ticked, and leads to its page.
    expect(guide.get_by_role("heading", name="Start a process")).to_be_visible()
    expect(guide.get_by_role("link", name="Robot")).to_have_attribute("href", "/cell/robots/ur10-1")
    keep(page, "home-first-run-process")
    guide.get_by_role("button", name="Start Bin picking").click()
    page.wait_for_url("**/work")
    running = f"{cell.url('task_orchestrator')}/processes?status=inProgress"
    wait_for(lambda: len(httpx.get(running, timeout=120).json()) == 1)

    page.goto("/")
    expect(guide.get_by_role("heading", name="Invite people")).to_be_visible()
    expect(guide.get_by_text("handover secure")).to_be_visible()
    keep(page, "home-first-run-people")
    accessible(page)
    guide.get_by_role("button", name="Continue alone").click()
    expect(guide).to_have_count(0)
    page.reload()
    page.get_by_role("heading", name="Running").wait_for()
    expect(guide).to_have_count(0)

    page.get_by_role("button", name="Show keyboard shortcuts").click()
    page.get_by_role("button", name="Show the first steps").click()
    expect(guide.get_by_role("heading", name="Invite people")).to_be_visible()
    guide.get_by_role("button", name="Hide").click()
    expect(guide).to_have_count(0)


def test_an_engineer_sees_what_is_wrong_and_what_runs(
    screen: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    start = {"definition": "bin-picking"}
    httpx.post(f"{screen.url('task_orchestrator')}/processes", json=start, timeout=120).raise_for_status()
    page = open_page("/", viewport=LAPTOP)
    page.add_init_script("localStorage.setItem('handover.firstSteps', 'dismissed')")
    page.reload()
    assert heads(page)[:2] == ["Needs attention", "Running"]
    process = page.get_by_role("link", name="Bin picking").first
    process.wait_for()
    for name in ("Needs attention", "Running", "Waiting for you"):
        box = page.get_by_role("heading", name=name, exact=True).bounding_box()
        assert box is not None
        assert box["y"] + box["height"] <= LAPTOP["height"]
    # A cell that is younger than the day says since when; yesterday is not compared.
    expect(page.get_by_role("heading", name="Today, since")).to_be_visible()
    expect(page.get_by_text("yesterday")).to_have_count(0)
    keep(page, "home-engineer-1366")
    accessible(page)
    dark = open_page("/", viewport=FULL_HD, theme="dark")
    dark.locator(".home__section h2").first.wait_for()
    keep(dark, "home-engineer-full-hd-dark")


def test_on_a_phone_what_waits_comes_first_and_opens_with_one_press(
    screen: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    controller = f"{screen.url('gesture_controller')}/gloves/glove-1"
    start = {"definition": "bin-picking"}
    if (
        not httpx.get(controller, timeout=120).is_success
        or httpx.get(controller, timeout=120).json()["task"] is None
    ):
        httpx.post(f"{screen.url('task_orchestrator')}/processes", json=start, timeout=120).raise_for_status()
        wait_for(lambda: httpx.get(controller, timeout=120).json().get("task") is not None)
    page = open_page("/", viewport=PHONE)
    page.add_init_script("localStorage.setItem('handover.firstSteps', 'dismissed')")
    page.reload()
    assert heads(page)[0] == "Waiting for you"
    row = page.get_by_role("link", name="At glove-1")
    box = row.bounding_box()
    assert box is not None
    assert box["y"] + box["height"] <= PHONE["height"]
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    keep(page, "home-phone")
    accessible(page)
    row.click()
    page.wait_for_url("**/work?glove=glove-1")
