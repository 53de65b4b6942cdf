"""The Study page: a participant completes it, also by keyboard, and the answers are shown."""

import re
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage, type_slowly
from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    return shared_cell


def code_of(page: Page) -> str:
    """Return the code with which the study leader takes the screen back."""
    said = page.get_by_text("unlocks it").inner_text()
    return re.sub(r"\D", "", said)


def leave(page: Page, code: str) -> None:
    """Take the screen back from a participant."""
    page.get_by_role("button", name="For the study leader").click()
    page.get_by_role("textbox", name="Code for this screen").fill(code)
    page.get_by_role("button", name="Leave the participant view").click()
    page.get_by_role("button", name="Start session").wait_for()


def tlx(page: Page, keep: Callable[[Page, str], Path], name: str, steps_up: int) -> None:
    """Answer NASA-TLX: each scale some steps above the middle, then always what stands first."""
    page.get_by_role("heading", name="How was the task?").wait_for()
    following = page.get_by_role("button", name="Next")
    expect(following).to_be_disabled()
    expect(page.get_by_text("not rated yet")).to_have_count(6)
    marks = "[...document.querySelectorAll('.scales [data-marked]')].length"
    assert page.evaluate(marks) == 0
    keep(page, f"study-{name}-open")
    for nth, scale in enumerate(page.get_by_role("slider").all()):
        assert scale.evaluate("(one) => getComputedStyle(one).accentColor") == "auto"
        assert scale.evaluate("(one) => getComputedStyle(one).getPropertyValue('--rated')") == "0%"
        assert page.evaluate(marks) == nth
        scale.focus()
        for _ in range(abs(steps_up)):
            scale.press("ArrowRight" if steps_up > 0 else "ArrowLeft")
    keep(page, f"study-{name}")
    following.click()
    for nth in range(15):
        page.get_by_text(f"{nth + 1} of 15").wait_for()
        if nth == 3:
            keep(page, f"study-{name}-pair")
        page.locator(".pair button").first.click()


def test_a_participant_completes_the_study_and_the_answers_are_shown(
    glove_screen: Cell,
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
) -> None:
    page = open_page("/admin/studies")
    page.get_by_role("heading", name="No answers yet").or_(page.get_by_text("No answers yet")).wait_for()
    accessible(page)
    code = code_of(page)
    page.get_by_role("button", name="Start session").click()
    page.get_by_role("heading", name="Before we begin").wait_for()
    accessible(page)
    keep(page, "study-consent")
    page.get_by_role("button", name="I have read this and want to take part").click()
    page.get_by_role("textbox", name="Age in years").fill("34")
    page.get_by_text("medium", exact=True).click()
    keep(page, "study-about")
    page.get_by_role("button", name="Next").click()
    page.get_by_role("heading", name="Sample task").wait_for()
    page.get_by_role("button", name="Task completed").click()
    page.get_by_role("heading", name="How was the system?").wait_for()
    for nth, group in enumerate(page.get_by_role("radiogroup").all()):
        group.get_by_role("radio").nth(3 if nth % 2 == 0 else 1).check(force=True)
    accessible(page)
    keep(page, "study-sus")
    page.reload()  # nothing that was acknowledged is asked again
    page.get_by_role("heading", name="How was the system?").wait_for()
    for nth, group in enumerate(page.get_by_role("radiogroup").all()):
        first = group.get_by_role("radio").first
        first.focus()
        first.press(" ")
        for _ in range(3 if nth % 2 == 0 else 1):
            page.keyboard.press("ArrowRight")
    page.get_by_role("button", name="Next").click()
    for nth, steps_up in ((1, -4), (2, 3)):
        page.get_by_role("button", name="Task completed").click()
        tlx(page, keep, f"tlx{nth}", steps_up)
    page.get_by_text("My own gestures", exact=True).click()
    accessible(page)
    keep(page, "study-preference")
    page.get_by_role("button", name="Finish").click()
    page.get_by_role("heading", name="Thank you").wait_for()
    leave(page, code)
    page.get_by_text("Mean 75.00").wait_for()
    accessible(page)
    keep(page, "study-results")
    (session,) = httpx.get(f"{glove_screen.url('study')}/sessions", timeout=120).json()
    assert (session["step"], session["pseudonym"]) == ("finished", "P01")
    page.get_by_role("button", name="Delete P01").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete P01").click()
    page.get_by_text("No sessions yet").wait_for()


def test_a_participant_reads_the_study_in_their_own_language(
    glove_screen: Cell,
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
) -> None:
    url = glove_screen.url("study")
    begun = httpx.post(f"{url}/sessions", json={"language": "fi"}, timeout=120).raise_for_status().json()
    consent = {"agreed": True, "text": begun["consentVersion"]}
    for step, content in (("consent", consent), ("introduction", {}), ("sample", {})):
        httpx.post(f"{url}/sessions/{begun['id']}/steps/{step}", json=content, timeout=120).raise_for_status()
    page = open_page(
        f"/admin/studies?session={begun['id']}", viewport={"width": 390, "height": 844}, theme="dark"
    )
    page.get_by_role("heading", name="Millainen järjestelmä oli?").wait_for()
    expect(page.get_by_role("button", name="Seuraava")).to_be_disabled()
    accessible(page)
    keep(page, "study-sus-phone-fi")


def test_a_participant_can_pause_or_withdraw_at_any_time(
    glove_screen: Cell,
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
) -> None:
    url = glove_screen.url("gesture_controller")
    glove = f"{url}/gloves/glove-1"
    httpx.put(f"{url}/people/kim", json={}, timeout=120).raise_for_status()
    httpx.put(f"{glove}/person", json={"person": "kim"}, timeout=120).raise_for_status()
    page = open_page("/admin/studies")
    code = code_of(page)
    page.get_by_text("kim has no personal gestures yet").wait_for()
    page.get_by_role("textbox", name="Pseudonym").fill("Kim")
    page.get_by_role("button", name="Start session").click()
    page.get_by_role("heading", name="Before we begin").wait_for()
    for path in ("/", "/admin/people", "/cell", "/admin/studies", "/work?glove=other", "/processes/1"):
        page.goto(path)
        if path.startswith("/work"):
            page.wait_for_url("**/work?glove=glove-1")
        else:
            page.get_by_role("heading", name="Before we begin").wait_for()
        assert page.get_by_role("navigation").count() == 0
        type_slowly(page, "g", "s")
        page.get_by_role("button", name="Pause or leave").wait_for()
    page.get_by_role("button", name="I have read this and want to take part").click()
    page.get_by_role("button", name="Next").click()
    page.get_by_role("button", name="Go to the task").click()
    page.get_by_role("button", name="Back to the questions").wait_for()
    page.locator(".work__stage h1").wait_for()
    keep(page, "study-at-work")
    page.get_by_role("button", name="Pause or leave").click()
    page.get_by_role("heading", name="Paused").wait_for()
    wait_for(lambda: httpx.get(glove, timeout=120).json()["paused"])
    accessible(page)
    keep(page, "study-paused")
    page.reload()
    page.get_by_role("heading", name="Paused").wait_for()
    page.get_by_role("button", name="For the study leader").click()
    page.get_by_role("textbox", name="Code for this screen").fill("0000")
    page.get_by_role("button", name="Leave the participant view").click()
    page.get_by_text("Wrong code").wait_for()
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Continue").click()
    wait_for(lambda: not httpx.get(glove, timeout=120).json()["paused"])
    page.get_by_role("button", name="Pause or leave").click()
    page.get_by_role("button", name="Leave the study and delete my answers").click()
    page.get_by_role("dialog").get_by_role("button", name="Leave the study and delete my answers").click()
    page.get_by_role("heading", name="You have left the study").wait_for()
    kept = [
        one["pseudonym"] for one in httpx.get(f"{glove_screen.url('study')}/sessions", timeout=120).json()
    ]
    assert "Kim" not in kept
    leave(page, code)
    page.get_by_role("navigation", name="Handover").wait_for()
