"""The Calibrate page with a real controller: thresholds are stepped, dragged, saved and reverted."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

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
    """One cell for all of this page's tests: each takes a finger of its own."""
    shared_cell.extra["HANDOVER_SILENCE_S"] = "60"  # a test's glove says nothing while the page is opened
    return shared_cell


def thresholds(cell: Cell) -> dict[str, Any]:
    """Return the thresholds that the controller reads glove-1 with."""
    return dict(
        httpx.get(f"{cell.url('gesture_controller')}/gloves/glove-1", timeout=120).json()["thresholds"]
    )


@pytest.mark.usefixtures("glove_screen")
def test_saved_thresholds_apply_and_can_be_reverted(
    cell: Cell, open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    before = thresholds(cell)
    page = open_page("/cell/gloves/glove-1/calibrate?finger=index")
    upper = page.get_by_role("textbox", name="Upper threshold of the index finger")
    expect(upper).to_have_value(f"{before['index']['upper']:,g}")
    upper.press("ArrowUp")
    page.get_by_role("button", name="Upper threshold of the index finger: up by 25").click()
    expect(upper).to_have_value(f"{before['index']['upper'] + 50:,g}")
    expect(page.get_by_text("1 finger changed, not saved")).to_be_visible()
    assert thresholds(cell) == before
    accessible(page)
    keep(page, "calibrate-unsaved")
    page.get_by_role("button", name="Save thresholds").click()
    expect(page.get_by_text("Saved and in use")).to_be_visible()
    assert thresholds(cell)["index"]["upper"] == before["index"]["upper"] + 50
    page.get_by_role("button", name="Restore previous thresholds").click()
    expect(upper).to_have_value(f"{before['index']['upper']:,g}")
    assert thresholds(cell) == before


@pytest.mark.usefixtures("glove_screen")
def test_a_dragged_threshold_can_be_discarded(cell: Cell, open_page: OpenPage) -> None:
    before = thresholds(cell)
    page = open_page("/cell/gloves/glove-1/calibrate?finger=ring")
    plot = page.get_by_role("img", name="Signal of the ring finger")
    plot.wait_for()
    plot.scroll_into_view_if_needed()
    area = plot.locator(".u-over").bounding_box()
    assert area is not None
    lower = page.get_by_role("textbox", name="Lower threshold of the ring finger")
    middle = area["x"] + area["width"] / 2

    def drag_from(height: float) -> None:
        page.mouse.move(middle, height)
        page.mouse.down()
        page.mouse.move(middle, area["y"] + area["height"] * 0.6, steps=4)
        page.mouse.up()

    # The lower line stands somewhere in the lower half: looked for from the bottom up.
    for share in (0.98, 0.92, 0.86, 0.8):
        drag_from(area["y"] + area["height"] * share)
        if lower.input_value() != f"{before['ring']['lower']:,g}":
            break
    expect(page.get_by_text("1 finger changed, not saved")).to_be_visible()
    page.get_by_role("button", name="Discard changes").click()
    wait_for(lambda: lower.input_value() == f"{before['ring']['lower']:,g}")
    assert thresholds(cell) == before


@pytest.mark.usefixtures("glove_screen")
def test_invalid_thresholds_are_not_sent(cell: Cell, open_page: OpenPage) -> None:
    before = thresholds(cell)
    page = open_page("/cell/gloves/glove-1/calibrate?finger=thumb")
    lower = page.get_by_role("textbox", name="Lower threshold of the thumb")
    lower.fill("many")
    lower.press("Enter")
    expect(lower).to_have_value(f"{before['thumb']['lower']:,g}")
    lower.fill("99999")
    lower.press("Enter")
    expect(lower).to_have_value(f"{before['thumb']['upper']:,g}")
    assert thresholds(cell) == before


def test_a_guided_calibration_names_the_unreliable_finger(
    glove_screen: Cell,
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
) -> None:
    page = open_page("/cell/gloves/glove-1/calibrate")
    with TcpGlove(glove_screen.ports["glove"]) as glove:
        page.get_by_role("button", name="Start calibration").click()
        page.get_by_text("Make a fist", exact=True).wait_for()  # the text beside the button contains it too
        keep(page, "calibrate-guided")
        shown = {"fist": "22202", "open": "00000"}  # a ring finger that stays as it is

        def is_led() -> bool:
            guide = httpx.get(f"{glove_screen.url('gesture_controller')}/gloves/glove-1", timeout=120).json()[
                "calibration"
            ]
            glove.show(shown[guide["step"]], 0.2)
            return guide["outcome"] is not None

        wait_for(is_led)
        warning = page.locator(".guided__outcome li").filter(has_text="ring finger")
        expect(warning).to_contain_text("always shows the same value")
        accessible(page)
        keep(page, "calibrate-sensor-warning")


@pytest.mark.parametrize("language", ["en", "de", "fi"])
@pytest.mark.usefixtures("glove_screen")
def test_numbers_are_not_truncated_on_a_phone(
    open_page: OpenPage, keep: Callable[[Page, str], Path], language: str
) -> None:
    page = open_page(
        "/cell/gloves/glove-1/calibrate", language=language, viewport={"width": 390, "height": 844}
    )
    page.locator(".calibrate__steps input").first.wait_for()
    page.evaluate("document.fonts.ready.then(() => true)")
    fields = page.locator(".calibrate__steps input").all()
    assert len(fields) == 10
    for field in fields:
        field.fill({"en": "1,800.25", "de": "1.800,25", "fi": "1 800,25"}[language])
        wide, room = field.evaluate("(one) => [one.scrollWidth, one.clientWidth]")
        assert wide <= room, f"{wide - room} px of a threshold are cut off"
        box = field.bounding_box()
        assert box is not None
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 390
    cut = page.evaluate(
        "[...document.querySelectorAll('.calibrate__finger, .calibrate__finger *')]"
        ".filter((one) => one.closest('svg') === null && getComputedStyle(one).display !== 'inline')"
        ".filter((one) => one.scrollWidth > one.clientWidth + 1).map((one) => one.className)"
    )
    assert cut == []
    fields[0].scroll_into_view_if_needed()
    keep(page, f"calibrate-phone-{language}")
