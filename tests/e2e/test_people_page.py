"""The page of people and gestures: a person is added, puts on the glove, and gives commands their own way."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.conftest import Cell, wait_until
from tests.e2e.conftest import OpenPage

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of this page's tests: each has a person of its own."""
    return shared_cell


def person(cell: Cell, name: str) -> dict[str, Any]:
    """Return a person as the controller has them."""
    answer = httpx.get(f"{cell.url('gesture_controller')}/people/{name}")
    return dict(answer.raise_for_status().json())


@pytest.mark.usefixtures("screen")
def test_a_person_is_added_puts_on_the_glove_and_exchanges_two_gestures(
    cell: Cell, open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    page = open_page("/people")
    page.get_by_role("button", name="Add a person").wait_for()
    page.keyboard.press("n")
    page.get_by_label("Short name").fill("anna")
    page.get_by_label("What people call them").fill("Anna K.")
    page.get_by_role("dialog").get_by_role("button", name="Add a person").click()
    expect(page.get_by_role("heading", name="Anna K.")).to_be_visible()
    page.get_by_label("glove-1 is worn by").select_option("anna")
    expect(page.get_by_role("button", name=re.compile("Anna K.*glove-1"))).to_be_visible()
    page.get_by_label("Command 3", exact=True).select_option("Horns")
    expect(page.get_by_label("Command 8", exact=True)).to_have_value("Thumbs up")
    expect(page.get_by_role("button", name="Command 3 as the site has it")).to_be_visible()
    accessible(page)
    keep(page, "people")
    kept = person(cell, "anna")
    assert [one["glove"] for one in kept["gloves"]] == ["glove-1"]
    assert (kept["commands"]["3"], kept["commands"]["8"]) == ("Horns", "Thumbs up")


@pytest.mark.usefixtures("screen")
def test_a_gesture_of_their_own_is_told_by_its_fingers_and_refused_when_there_is_one_like_it(
    cell: Cell, open_page: OpenPage, accessible: Callable[[Page], None]
) -> None:
    httpx.put(f"{cell.url('gesture_controller')}/people/ben", json={}).raise_for_status()
    page = open_page("/people?person=ben", forgives=("a status of 409",))
    page.get_by_label("What it is called").fill("Mine")
    page.get_by_role("radio", name="thumb straight").click()
    page.get_by_role("button", name="Add the gesture").click()
    refused = page.get_by_role("alert")
    expect(refused).to_contain_text("Thumbs up")
    accessible(page)
    page.get_by_role("radio", name="Two in turn").click()
    page.get_by_label("First").select_option("Horns")
    page.get_by_label("Then").select_option("Thumbs up")
    page.get_by_role("button", name="Add the gesture").click()
    expect(page.get_by_text("Mine is there")).to_be_visible()
    expect(page.get_by_role("button", name="Delete Mine")).to_be_visible()
    wait_until(lambda: "Mine" in person(cell, "ben")["ownGestures"])
