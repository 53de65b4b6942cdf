"""The Test page: recognized gestures, and an accuracy test."""

from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell
from tests.kit.gloves import TcpGlove
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    shared_cell.extra["HANDOVER_SILENCE_S"] = "60"
    return shared_cell


@pytest.fixture
def glove(glove_screen: Cell) -> Iterator[TcpGlove]:
    with TcpGlove(glove_screen.ports["glove"]) as made:
        yield made


def test_a_gesture_is_marked_recognized_or_not(
    glove: TcpGlove,
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
) -> None:
    page = open_page("/cell/gloves/glove-1/test?gesture=Thumbs%20up")
    page.get_by_role("button", name="Switch test mode on").click()
    page.get_by_text("Test mode is on").wait_for()
    glove.show("02202", 0.6)
    page.locator(".test__side--wrong").wait_for()
    accessible(page)
    keep(page, "test-try-wrong")
    glove.show("02222", 0.6)
    page.locator(".test__side--right").get_by_text("Thumbs up").wait_for()
    accessible(page)
    keep(page, "test-try-right")
    page.get_by_role("button", name="Switch test mode off").click()
    page.get_by_text("Test mode is off").wait_for()


def test_an_accuracy_test_ends_with_a_report(
    cell: Cell,
    glove: TcpGlove,
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
) -> None:
    page = open_page("/cell/gloves/glove-1/test?part=accuracy&rounds=1")
    page.get_by_role("button", name="Start 21 trials").click()
    page.get_by_role("heading", name="Open your hand").wait_for()
    accessible(page)
    controller = httpx.Client(base_url=cell.url("gesture_controller"), timeout=120, trust_env=False)

    def seen() -> dict[str, object] | None:
        return controller.get("/gloves/glove-1").json()["accuracyTest"]  # type: ignore[no-any-return]  # JSON

    met: set[str] = set()

    def moves() -> bool:
        test = seen()
        if test is None:
            return True
        asked = test["asked"]
        if isinstance(asked, dict):
            is_new = asked["gesture"] not in met
            met.add(asked["gesture"])
            if is_new and len(met) == 4:
                page.get_by_text("Show and hold").wait_for()
                keep(page, "test-asked")
            glove.show("20022" if is_new and asked["gesture"] == "Horns" else asked["code"], 0.6)
        else:
            glove.show("00000", 0.4)
        return False

    wait_for(moves, within_s=90)
    page.get_by_role("heading", name="Confusion matrix").wait_for()
    expect(page.get_by_text("95.24%")).to_be_visible()
    page.wait_for_timeout(300)  # the table has come to rest for its picture
    accessible(page)
    keep(page, "test-report")
    answer = controller.get(page.get_by_role("link", name="CSV").get_attribute("href").split("controller")[1])
    assert len(answer.text.splitlines()) == 22
    controller.close()
