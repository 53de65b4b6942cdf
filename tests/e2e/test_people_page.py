"""The People page: a person is added, wears the glove, and customizes gestures."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, Route, expect

from tests.e2e.conftest import OpenPage, type_slowly
from tests.kit.cell import Cell
from tests.kit.gloves import TcpGlove
from tests.kit.waiting import wait_for

REFUSED = "the server responded with a status of 409"
"""What Chromium logs of an answer that the page shows."""

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of this page's tests: each has a person of its own."""
    shared_cell.extra["HANDOVER_SILENCE_S"] = "60"  # a test's glove says nothing while the page is opened
    return shared_cell


def person(cell: Cell, name: str) -> dict[str, Any]:
    """Return a person as the controller has them."""
    answer = httpx.get(f"{cell.url('gesture_controller')}/people/{name}", timeout=120)
    return dict(answer.raise_for_status().json())


def pick(page: Page, label: str, gesture: str) -> None:
    """Choose a gesture in the picker called `label`: find it by its name, touch its picture."""
    page.get_by_role("button", name=re.compile(f"^{label} ")).click()
    panel = page.get_by_role("dialog", name=label)
    panel.get_by_role("searchbox").fill(gesture)
    panel.get_by_role("option", name=gesture, exact=True).click()
    panel.wait_for(state="detached")


@pytest.mark.usefixtures("glove_screen")
def test_a_person_is_added_and_exchanges_two_gestures(
    cell: Cell, open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    page = open_page("/admin/people")
    page.get_by_role("button", name="Add a person").wait_for()
    type_slowly(page, "g", "n")
    page.get_by_label("Short name").fill("anna")
    page.get_by_label("Display name").fill("Anna K.")
    page.get_by_role("dialog").get_by_role("button", name="Add a person").click()
    expect(page.get_by_role("heading", name="Anna K.")).to_be_visible()
    page.get_by_label("Wearer of glove-1").select_option("anna")
    expect(page.get_by_role("row", name=re.compile("Anna K.*glove-1"))).to_be_visible()
    pick(page, "Command 3", "Horns")
    expect(page.get_by_role("button", name="Command 8 Thumbs up")).to_be_visible()
    expect(page.get_by_role("button", name="Reset command 3 to the site default")).to_be_visible()
    accessible(page)
    keep(page, "people")
    kept = person(cell, "anna")
    assert [one["glove"] for one in kept["gloves"]] == ["glove-1"]
    assert (kept["commands"]["3"], kept["commands"]["8"]) == ("Horns", "Thumbs up")


@pytest.mark.usefixtures("glove_screen")
def test_a_dialog_keeps_the_focus_while_the_people_are_loaded(cell: Cell, open_page: OpenPage) -> None:
    httpx.put(f"{cell.url('gesture_controller')}/people/gina", json={}, timeout=120).raise_for_status()
    page = open_page("/nothing")
    held: list[Route] = []
    is_shown = False

    def hold(route: Route) -> None:
        if is_shown:
            route.continue_()
        else:
            held.append(route)

    page.route("**/api/gesture-controller/people", hold)
    page.get_by_role("link", name="People").click()
    page.get_by_role("button", name="Add a person").wait_for()
    type_slowly(page, "g", "n")
    page.get_by_label("Short name").fill("h")
    page.evaluate("document.activeElement.addEventListener('blur', () => { document.title = 'focus lost' })")
    is_shown = True
    for route in held:
        route.continue_()
    page.locator(".people__place h2").first.wait_for()
    page.keyboard.type("ugo")
    expect(page.get_by_label("Short name")).to_have_value("hugo")
    assert page.title() != "focus lost"


@pytest.mark.usefixtures("glove_screen")
def test_two_browsers_show_the_same_without_a_reload(cell: Cell, open_page: OpenPage) -> None:
    httpx.put(f"{cell.url('gesture_controller')}/people/eva", json={}, timeout=120).raise_for_status()
    one, other = open_page("/admin/people?person=eva"), open_page("/admin/people?person=eva")
    for page in (one, other):
        expect(page.get_by_role("button", name="Command 3 Thumbs up")).to_be_visible()
    pick(one, "Command 3", "Horns")
    expect(other.get_by_role("button", name="Command 3 Horns")).to_be_visible()
    # What is changed without a browser reaches both as well.
    httpx.put(f"{cell.url('gesture_controller')}/people/fred", json={}, timeout=120).raise_for_status()
    for page in (one, other):
        page.mouse.move(1200, 700)  # a table with the pointer in it keeps its rows
        expect(page.get_by_role("row", name=re.compile("^fred"))).to_be_visible(timeout=120_000)


@pytest.mark.usefixtures("glove_screen")
def test_a_custom_gesture_is_defined_by_fingers_and_rejected_if_ambiguous(
    cell: Cell, open_page: OpenPage, accessible: Callable[[Page], None]
) -> None:
    httpx.put(f"{cell.url('gesture_controller')}/people/ben", json={}, timeout=120).raise_for_status()
    page = open_page("/admin/people?person=ben", forgives=(REFUSED,))
    page.get_by_label("Name", exact=True).fill("Mine")
    page.get_by_role("radiogroup", name="thumb").get_by_role("radio", name="straight").click()
    page.get_by_role("button", name="Add the gesture").click()
    refused = page.get_by_role("alert")
    expect(refused).to_contain_text("Thumbs up")
    accessible(page)
    page.get_by_role("radio", name="Two in sequence").click()
    pick(page, "First", "Horns")
    pick(page, "Then", "Thumbs up")
    page.get_by_role("button", name="Add the gesture").click()
    expect(page.get_by_text("Mine added")).to_be_visible()
    expect(page.get_by_role("button", name="Delete Mine")).to_be_visible()
    wait_for(lambda: "Mine" in person(cell, "ben")["ownGestures"])


def test_a_gesture_is_recorded_and_exported_in_the_profile(glove_screen: Cell, open_page: OpenPage) -> None:
    controller = glove_screen.url("gesture_controller")
    for name in ("carl", "dora"):
        httpx.put(f"{controller}/people/{name}", json={}, timeout=120).raise_for_status()
    httpx.put(f"{controller}/gloves/glove-1/person", json={"person": "carl"}, timeout=120).raise_for_status()
    with TcpGlove(glove_screen.ports["glove"]) as glove:
        page = open_page("/admin/people?person=carl")
        page.get_by_role("radio", name="Recording").click()
        page.get_by_label("Name", exact=True).fill("Three")
        page.get_by_role("button", name="Record now").click()
        delete = page.get_by_role("button", name="Delete Three")

        def is_recorded() -> bool:
            glove.show("00002", 0.1)
            return delete.is_visible()

        wait_for(is_recorded)
    expect(page.get_by_text("Three added; the closest other gesture is")).to_be_visible()
    assert person(glove_screen, "carl")["ownGestures"]["Three"]["code"] == "00002"
    with page.expect_download() as download:
        page.get_by_role("button", name="Export profile").click()
    profile = download.value.path()
    assert download.value.suggested_filename == "carl.yaml"
    page.get_by_role("row", name=re.compile("^dora")).click()
    page.get_by_role("heading", name="dora").wait_for()
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Import profile").click()
    chooser.value.set_files(
        {"name": "carl.yaml", "mimeType": "application/yaml", "buffer": profile.read_bytes()}
    )
    delete.wait_for()
    assert "Three" in person(glove_screen, "dora")["ownGestures"]


@pytest.mark.parametrize("touch", [False, True], ids=["keyboard", "touch"])
def test_a_gesture_is_found_among_many_by_its_picture_or_its_name(
    glove_screen: Cell,
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
    *,
    touch: bool,
) -> None:
    httpx.put(f"{glove_screen.url('gesture_controller')}/people/eve", json={}, timeout=120).raise_for_status()
    httpx.put(
        f"{glove_screen.url('gesture_controller')}/people/eve/commands", json={}, timeout=120
    ).raise_for_status()
    size = {"width": 390, "height": 844} if touch else {"width": 1280, "height": 800}
    page = open_page("/admin/people?person=eve", viewport=size, has_touch=touch, language="de")
    page.get_by_role("button", name=re.compile("^Befehl 3 ")).click()
    panel = page.get_by_role("dialog")
    assert panel.get_by_role("option").count() == 22, "every gesture, and none"
    accessible(page)
    keep(page, f"people-picker-{'phone' if touch else 'panel'}")
    for tile in panel.get_by_role("option").all():
        box = tile.bounding_box()
        assert box is not None
        assert min(box["width"], box["height"]) >= 120, "a tile is hit with a glove on"
        assert tile.evaluate("(one) => one.scrollHeight <= one.clientHeight + 1"), "a name is cut off"
    if touch:
        panel.get_by_role("option", name="Hörner", exact=True).tap()
    else:
        type_slowly(page, *"hörn")
        assert panel.get_by_role("option").count() == 1
        type_slowly(page, "Enter")
    panel.wait_for(state="detached")
    wait_for(lambda: person(glove_screen, "eve")["commands"]["3"] == "Horns")
