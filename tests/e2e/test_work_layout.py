"""The Work page at the distance of an operator: angular size of type, visibility, contrast."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page

from services.task_orchestrator.tests.unit.drawing import drawing, end, path, start
from tests.e2e.conftest import STILL, OpenPage, appearing
from tests.e2e.test_operators_page import Wearer
from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(600)]

WORK = "/work?glove=glove-1"
SIZES = {
    "4k": {"width": 3840, "height": 2160},
    "desk": {"width": 1920, "height": 1080},
    "tablet": {"width": 820, "height": 1180},
    "phone": {"width": 390, "height": 844},
}
STATIONS = {"4k": (24.0, 2.0), "desk": (24.0, 2.0), "tablet": (24.0, 2.0), "phone": (6.1, 0.4)}
"""Screen diagonal in inches and viewing distance in metres; a phone is held in the hand."""
LOOKS = [("en", "light"), ("de", "dark"), ("fi", "light"), ("en", "dark"), ("de", "light"), ("fi", "dark")]
MAIN = {"en": "Complete by hand", "de": "Manuell erledigen", "fi": "Kuittaa käsin"}
NOT_GOOD = {"en": "Not good", "de": "Nicht in Ordnung", "fi": "Ei kunnossa"}
READ_ARCMIN, GESTURE_ARCMIN = 16.0, 24.0
MIN_CONTRAST = 7.0

ASKED_ONCE = (
    '<bpmn:userTask id="look" name="Look at the part"><bpmn:extensionElements>'
    '<handover:task definition="look"><handover:involves resource="Device:glove-1"/>'
    '<handover:parameter name="gesture" value="Thumbs up"/>'
    '<handover:parameter name="description" value="Look at the part and say whether it is good"/>'
    "</handover:task></bpmn:extensionElements></bpmn:userTask>"
)

QUESTION = {
    "en": "Look at the part and say whether it is good",
    "de": "Sehen Sie das Teil an und sagen Sie, ob es gut ist",
    "fi": "Katso osaa ja kerro, onko se hyvä",
}
TRANSLATED = "".join(
    f'<handover:translations language="{language}"><handover:translation source="{QUESTION["en"]}">'
    f"{QUESTION[language]}</handover:translation></handover:translations>"
    for language in ("de", "fi")
)

SEEN = """() => {
  const clips = (one, box) => {
    const clip = one.getBoundingClientRect();
    if (getComputedStyle(one).overflowX === "visible") return false;
    const beside = box.left < clip.left - 1 || box.right > clip.right + 1;
    return beside || box.top < clip.top - 3 || box.bottom > clip.bottom + 3;
  };
  const canvas = document.createElement("canvas").getContext("2d");
  const work = document.querySelector(".work");
  const rgb = (text) => (text.match(/[\\d.]+/g) ?? []).map(Number);
  const luminance = ([r, g, b]) => {
    const part = (v) => (v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4);
    return 0.2126 * part(r) + 0.7152 * part(g) + 0.0722 * part(b);
  };
  const ground = (element) => {
    for (let one = element; one !== null; one = one.parentElement) {
      const [r, g, b, a = 1] = rgb(getComputedStyle(one).backgroundColor);
      if (a === 1 && r !== undefined) return [r, g, b];
    }
    return [255, 255, 255];
  };
  const seen = [];
  const texts = document.createTreeWalker(work, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const text = texts.currentNode;
    const element = text.parentElement;
    if (text.data.trim() === "" || element.closest(".visually-hidden, svg") !== null) continue;
    const range = document.createRange();
    range.selectNodeContents(text);
    const box = range.getBoundingClientRect();
    if (box.width === 0 || box.height === 0) continue;
    const style = getComputedStyle(element);
    canvas.font = `${style.fontWeight} ${style.fontSize} ${style.fontFamily}`;
    let cut = Math.min(box.left, box.top) < -1 || box.right > innerWidth + 1 || box.bottom > innerHeight + 1;
    for (let one = element; one !== document.body; one = one.parentElement) cut ||= clips(one, box);
    const [one, other] = [luminance(rgb(style.color)), luminance(ground(element))];
    seen.push({
      text: text.data,
      capPx: canvas.measureText("H").actualBoundingBoxAscent,
      cut,
      contrast: (Math.max(one, other) + 0.05) / (Math.min(one, other) + 0.05),
      disabled: element.closest("[disabled], [data-disabled]") !== null,
      gesture: element.closest(".work__gesture") !== null && element.closest(".work__show") === null,
      corrective: element.closest(".work__message") !== null,
      instruction: element.closest(".work__task") !== null,
    });
  }
  return seen;
}"""

BLANKS = """() => {
  window.blanks = [];
  window.stages = new Set();
  const look = () => {
    const title = document.querySelector(".work__stage h1");
    const box = title?.getBoundingClientRect();
    let opacity = 1;
    for (let one = title; one != null; one = one.parentElement) opacity *= getComputedStyle(one).opacity;
    const away = title == null || title.textContent === "" || box.right < 0 || box.left > innerWidth;
    if (away || opacity < 0.99) {
      window.blanks.push(`${title?.textContent ?? "nothing"} at ${opacity}`);
    } else window.stages.add(title.textContent);
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
}"""


BEGINS_ABOVE = """() => {
  const box = document.querySelector(".work__text");
  const top = box.getBoundingClientRect().top - box.scrollTop;
  const isAbove = (one) => one.getBoundingClientRect().top < top - 1;
  return [...box.children].filter(isAbove).map((one) => one.textContent);
}"""
"""The parts of the question that begin before the place to which its box can be scrolled."""

FITS = """() => {
  window.fits = {};
  const note = () => {
    const { situation, fit } = document.querySelector(".work__page").dataset;
    window.fits[situation] = Number(fit);
    requestAnimationFrame(note);
  };
  note();
}"""


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell, with gestures for every answer. A glove that was worn in it is lost: that test comes last."""
    file = shared_cell.data_dir / "gestures.yaml"
    file.write_text("answers: {notGood: Ring straight, problem: Little straight}\n")
    shared_cell.extra["HANDOVER_GESTURES_FILE"] = str(file)
    return shared_cell


@pytest.fixture
def asked(quiet_screen: Cell) -> Callable[[], str]:
    """Start a process that asks glove-1 once and handles no other outcome than ok; return its id."""
    orchestrator = quiet_screen.url("task_orchestrator")
    translated = f"<bpmn:extensionElements>{TRANSLATED}</bpmn:extensionElements>"
    body = translated + start() + ASKED_ONCE + end() + path("start", "look", "end")
    xml = drawing(body, name="looking")
    httpx.post(
        f"{orchestrator}/definitions", content=xml, headers={"Content-Type": "application/xml"}, timeout=120
    ).raise_for_status()

    def ask() -> str:
        begun = (
            httpx.post(f"{orchestrator}/processes", json={"definition": "looking"}, timeout=120)
            .raise_for_status()
            .json()
        )
        glove = f"{quiet_screen.url('gesture_controller')}/gloves/glove-1"
        wait_for(lambda: httpx.get(glove, timeout=120).json()["task"] is not None)
        return str(begun["id"])

    return ask


def arcmin(px: float, size: str) -> float:
    """Return the angle that `px` CSS pixels have at the station of a screen size."""
    diagonal_in, distance_m = STATIONS[size]
    px_per_mm = math.hypot(*SIZES[size].values()) / (diagonal_in * 25.4)
    return math.degrees(2 * math.atan(px / px_per_mm / (2000 * distance_m))) * 60


def look(page: Page, language: str, theme: str) -> None:
    """Show the page in another language and theme."""
    page.evaluate("language => localStorage.setItem('handover.language', language)", language)
    page.emulate_media(color_scheme=theme)  # type: ignore[arg-type]
    page.reload()
    page.locator("[data-situation]:not([data-situation=connecting])").wait_for()
    page.evaluate("document.fonts.ready.then(() => true)")
    page.evaluate(STILL)


def readable(page: Page, size: str) -> list[dict[str, Any]]:
    """Check all text of the page by its angle, its place and its contrast; return what there is."""
    seen: list[dict[str, Any]] = page.evaluate(SEEN)
    assert seen
    for one in seen:
        angle = arcmin(one["capPx"], size)
        least = GESTURE_ARCMIN if one["gesture"] else READ_ARCMIN
        assert angle >= least - 0.3, f"{one['text']!r} is {angle:.1f} minutes of arc high, not {least:g}"
        assert not one["cut"], f"{one['text']!r} is cut off"
        assert one["disabled"] or one["contrast"] >= MIN_CONTRAST, f"{one['text']!r}: {one['contrast']:.1f}:1"
    scrolls = page.evaluate(
        "(({scrollHeight, scrollWidth}) => [scrollHeight - innerHeight, scrollWidth - innerWidth])"
        "(document.documentElement)"
    )
    assert max(scrolls) <= 0, f"the page scrolls by {scrolls} px"
    return seen


def assert_visible(page: Page, name: str) -> None:
    """Check that a button lies within the screen as a whole, and is large enough for a glove."""
    box = page.get_by_role("button", name=name).last.bounding_box()
    screen = page.viewport_size
    assert box is not None
    assert screen is not None
    assert min(box["x"], box["y"]) >= 0
    assert box["x"] + box["width"] <= screen["width"] + 1
    assert box["y"] + box["height"] <= screen["height"] + 1
    assert min(box["width"], box["height"]) >= 55


@pytest.mark.parametrize("size", SIZES)
def test_the_prompt_is_readable_from_the_station_and_answered_without_scrolling(
    asked: Callable[[], str], open_page: OpenPage, keep: Callable[[Page, str], Path], size: str
) -> None:
    asked()
    page = open_page(WORK, viewport=SIZES[size])
    for language, theme in LOOKS:
        look(page, language, theme)
        seen = readable(page, size)
        corrective = {one["capPx"] for one in seen if one["corrective"]}
        assert corrective == {one["capPx"] for one in seen if one["instruction"]}
        assert any(one["gesture"] for one in seen)
        assert [one["text"] for one in seen if one["instruction"]] == [QUESTION[language]]
        assert_visible(page, MAIN[language])
        assert_visible(page, NOT_GOOD[language])
        keep(page, f"work-asked-{size}-{language}-{theme}")
        hand = page.locator(".figure .hand").bounding_box()
        assert hand is not None
        if size in {"4k", "desk"}:
            assert hand["height"] >= 0.6 * SIZES[size]["height"]
            words = page.locator(".work__text").bounding_box()
            figure = page.locator(".figure").bounding_box()
            assert words is not None
            assert figure is not None
            assert words["width"] + figure["width"] >= 0.85 * SIZES[size]["width"]


@pytest.mark.parametrize(("width", "height"), [(683, 314), (640, 300), (320, 500)])
def test_the_question_stands_as_a_whole_on_a_magnified_page(
    asked: Callable[[], str], open_page: OpenPage, keep: Callable[[Page, str], Path], width: int, height: int
) -> None:
    """At 200 % the window of a browser has no room for all: the buttons are reached by scrolling."""
    asked()
    page = open_page(WORK, viewport={"width": width, "height": height}, device_scale_factor=2)
    for language in ("en", "de"):
        look(page, language, "light")
        keep(page, f"work-magnified-{width}-{language}")
        seen = {one["text"]: one["cut"] for one in page.evaluate(SEEN)}
        assert seen[QUESTION[language]] is False
        page.get_by_role("button", name=MAIN[language]).last.scroll_into_view_if_needed()
        assert_visible(page, MAIN[language])


def test_the_question_is_reached_on_a_magnified_page_and_its_place_is_marked_in_forced_colours(
    asked: Callable[[], str], open_page: OpenPage, keep: Callable[[Page, str], Path]
) -> None:
    """At 200 % of a small screen, what has no room is reached by scrolling, and the buttons stay."""
    asked()
    page = open_page(WORK, viewport={"width": 640, "height": 400}, device_scale_factor=2)
    look(page, "en", "light")
    question = page.locator(".work__text > :first-child")
    question.scroll_into_view_if_needed()
    keep(page, "work-magnified")
    hidden = page.evaluate(BEGINS_ABOVE)
    assert hidden == [], "what begins above its box cannot be scrolled to"
    assert_visible(page, MAIN["en"])
    page.emulate_media(forced_colors="active")
    grounds = page.evaluate(
        "[...document.querySelectorAll('.rail__place')].map((link) =>"
        " [link.hasAttribute('aria-current'), getComputedStyle(link).backgroundColor])"
    )
    marked = {ground for is_current, ground in grounds if is_current}
    assert marked
    assert marked.isdisjoint(ground for is_current, ground in grounds if not is_current)


@pytest.mark.parametrize("size", SIZES)
def test_paused_and_stopped_states_are_readable_from_a_distance(
    cell: Cell,
    asked: Callable[[], str],
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    size: str,
) -> None:
    asked()
    glove = f"{cell.url('gesture_controller')}/gloves/glove-1"
    page = open_page(WORK, viewport=SIZES[size])
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("heading", name="Paused").wait_for()
    for language, theme in LOOKS[1:4]:
        look(page, language, theme)
        fills_the_stage(page, size, "attention")
        keep(page, f"work-paused-{size}-{language}-{theme}")
    look(page, "en", "light")
    assert_visible(page, "Resume")
    page.get_by_role("button", name="Resume").last.click()
    page.locator("[data-situation=prompt]").wait_for()
    task = httpx.get(glove, timeout=120).json()["task"]["id"]
    answer = {"by": "Anna", "task": task, "outcome": "notGood", "note": "There is a scratch on the left side"}
    httpx.post(f"{glove}/complete", json=answer, timeout=120).raise_for_status()
    page.locator("[data-situation=incident]").wait_for()
    for language, theme in LOOKS[2:5]:
        look(page, language, theme)
        assert "There is a scratch on the left side" in page.locator(".full-page-state").inner_text()
        fills_the_stage(page, size, "stop")
        keep(page, f"work-incident-{size}-{language}-{theme}")


def fills_the_stage(page: Page, size: str, tone: str) -> None:
    """Check a state of the whole page: an icon, a word as large as a gesture's, a colour that fills it."""
    readable(page, size)
    state = page.locator(f".full-page-state--{tone}")
    box, stage = state.bounding_box(), page.locator(".work__stage").bounding_box()
    assert box is not None
    assert stage is not None
    assert box["width"] * box["height"] >= 0.98 * stage["width"] * stage["height"]
    assert state.locator("svg").first.is_visible()
    cap = state.locator("h1").evaluate("(title) => parseFloat(getComputedStyle(title).fontSize) * 0.727")
    assert arcmin(cap, size) >= GESTURE_ARCMIN
    colour = state.evaluate("(state) => getComputedStyle(state).backgroundColor")
    assert colour != page.evaluate("getComputedStyle(document.body).backgroundColor")


@pytest.mark.parametrize("outcome", ["Not good", "Problem"])
def test_a_person_reports_not_good_with_a_note(
    cell: Cell,
    asked: Callable[[], str],
    open_page: OpenPage,
    accessible: Callable[[Page], None],
    outcome: str,
) -> None:
    process = asked()
    page = open_page(WORK, viewport=SIZES["desk"])
    page.get_by_role("button", name=outcome, exact=True).click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_text("Look at the part and say whether it is good").wait_for()
    accessible(page)
    dialog.get_by_role("textbox", name="Note (optional)").fill("scratched")
    act = {"Not good": "Report “Not good”", "Problem": "Report the problem"}[outcome]
    page.evaluate(FITS)
    with appearing(page, f"Reported: {outcome}"):
        dialog.get_by_role("button", name=act).click()
    page.locator("[data-situation=incident]").wait_for()
    page.get_by_text(f"Look at the part: {outcome}, reported by Anna. “scratched”").wait_for()
    found = httpx.get(f"{cell.url('task_orchestrator')}/processes/{process}", timeout=120).json()
    (task,) = found["tasks"]
    assert (found["status"], task["status"]) == ("inProgress", "failed")
    assert [incident["task"] for incident in found["incidents"]] == [task["id"]]
    fits = page.evaluate("window.fits")
    assert fits["answered"] <= 3, "so few words are as large as can be"
    outputs = task["outputParameters"]
    assert outputs["outcome"] == {"Not good": "notGood", "Problem": "problem"}[outcome]
    assert (outputs["note"], outputs["operator"], outputs["by"]) == ("scratched", "Anna", "screen")


def test_station_settings_are_stored(
    asked: Callable[[], str], open_page: OpenPage, keep: Callable[[Page, str], Path]
) -> None:
    asked()
    page = open_page(WORK, viewport=SIZES["desk"])
    texts = "[...document.querySelectorAll('.work :is(p, h1, .status-badge)')]"
    smallest = f"Math.min(...{texts}.map((one) => parseFloat(getComputedStyle(one).fontSize)))"
    page.locator("[data-situation=prompt]").wait_for()
    page.evaluate("document.fonts.ready.then(() => true)")
    before = page.evaluate(smallest)
    page.get_by_role("button", name="Screen and viewing distance").click()
    for _ in range(5):
        page.get_by_role("button", name="Viewing distance: more").click()
    page.get_by_text("2.5 m", exact=True).wait_for()
    keep(page, "work-station")
    page.get_by_role("button", name="Save for this screen").click()
    page.get_by_role("dialog").wait_for(state="detached")
    assert page.evaluate(smallest) == pytest.approx(before * 2.5 / 2.0, rel=0.02)
    page.reload()
    page.locator("[data-situation=prompt]").wait_for()
    assert page.evaluate(smallest) == pytest.approx(before * 2.5 / 2.0, rel=0.02)
    assert_visible(page, MAIN["en"])


@pytest.mark.parametrize("size", SIZES)
def test_a_finished_step_is_looked_at_again_until_the_next_question(
    *,
    asked: Callable[[], str],
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
    size: str,
) -> None:
    asked()
    page = open_page(WORK, viewport=SIZES[size])
    with appearing(page, "Completed by Anna"):
        page.get_by_role("button", name="Complete by hand").click()
    page.locator("[data-situation=completed]").wait_for()
    assert_visible(page, "Finished steps")
    readable(page, size)
    page.get_by_role("button", name="Finished steps").click()
    dialog = page.get_by_role("dialog", name="Finished steps")
    dialog.get_by_text(QUESTION["en"]).wait_for()
    dialog.get_by_text("Completed by Anna").wait_for()
    accessible(page)
    keep(page, f"work-finished-steps-{size}")
    smallest = dialog.evaluate(
        "(dialog) => Math.min(...[...dialog.querySelectorAll('p, time, strong, span, button')]"
        ".map((one) => parseFloat(getComputedStyle(one).fontSize)))"
    )
    assert arcmin(smallest * 0.727, size) >= READ_ARCMIN - 0.3
    assert_visible(page, "Back to the step")
    asked()
    page.locator("[data-situation=prompt]").wait_for()
    dialog.wait_for(state="detached")


@pytest.mark.parametrize("size", SIZES)
def test_a_station_hides_the_navigation_until_a_held_corner_or_escape_brings_it_back(
    asked: Callable[[], str], open_page: OpenPage, keep: Callable[[Page, str], Path], size: str
) -> None:
    asked()
    page = open_page(WORK, viewport=SIZES[size])

    def hide() -> None:
        page.get_by_role("button", name="Screen and viewing distance").click()
        page.get_by_text("Hide the navigation on this screen").click()
        keep(page, f"work-station-{size}")
        page.get_by_role("button", name="Save for this screen").click()
        page.locator(".rail").wait_for(state="detached")
        assert page.locator(".shell__bar").count() == 0

    hide()
    page.reload()
    page.locator("[data-situation=prompt]").wait_for()
    assert page.locator(".rail").count() == 0
    for language, theme in LOOKS[:3]:
        look(page, language, theme)
        readable(page, size)
        assert_visible(page, MAIN[language])
        keep(page, f"work-kiosk-{size}-{language}-{theme}")
    look(page, "en", "light")
    page.mouse.move(20, 20)
    page.mouse.down()
    page.locator(".rail").wait_for(state="attached")
    page.mouse.up()
    hide()
    page.keyboard.press("Escape")
    page.get_by_role("dialog").get_by_role("button", name="Show the navigation").click()
    page.locator(".rail").wait_for(state="attached")


def test_testing_mode_can_be_ended_on_the_page(
    cell: Cell, asked: Callable[[], str], open_page: OpenPage, keep: Callable[[Page, str], Path]
) -> None:
    asked()
    glove = f"{cell.url('gesture_controller')}/gloves/glove-1"
    httpx.put(f"{glove}/modes", json={"testing": True}, timeout=120).raise_for_status()
    page = open_page(WORK, viewport=SIZES["phone"])
    page.get_by_text("Test mode: gestures are shown but not sent.").wait_for()
    readable(page, "phone")
    assert_visible(page, "Leave test mode")
    keep(page, "work-testing")
    page.get_by_role("button", name="Leave test mode").click()
    page.get_by_role("button", name="Complete by hand").wait_for()
    assert httpx.get(glove, timeout=120).json()["testing"] is False


@pytest.mark.usefixtures("quiet_screen")
def test_the_page_is_never_blank_between_two_steps(open_page: OpenPage) -> None:
    page = open_page(WORK)
    page.get_by_role("button", name="Start Bin picking").click()
    page.get_by_role("heading", name="Confirm that nobody").wait_for()
    page.evaluate(BLANKS)
    with appearing(page, "Completed by Anna"):
        page.get_by_role("button", name="Complete by hand").click()
    page.locator("[data-situation=robot]").wait_for()
    page.locator("[data-situation=prompt]").wait_for(timeout=120_000)
    assert page.evaluate("window.stages.size") >= 3
    assert page.evaluate("window.blanks") == []


def test_answer_gestures_and_a_lost_glove_are_readable_from_a_distance(
    cell: Cell, asked: Callable[[], str], open_page: OpenPage, keep: Callable[[Page, str], Path]
) -> None:
    process = asked()
    wearer = Wearer(cell.ports["glove"])
    try:
        page = open_page(WORK, viewport=SIZES["desk"])
        page.get_by_role("img", name="Ring straight").wait_for()
        readable(page, "desk")
        keep(page, "work-answers")
        wearer.show("22222")
        page.wait_for_timeout(300)
        with appearing(page, "Reported: Not good"):
            with appearing(page, "Not good? Keep holding"):
                wearer.show("22202")
            keep(page, "work-hold-not-good")
        wearer.show("22222")
        page.locator("[data-situation=incident]").wait_for()
        (task,) = httpx.get(f"{cell.url('task_orchestrator')}/processes/{process}", timeout=120).json()[
            "tasks"
        ]
        assert (task["status"], task["outputParameters"]["outcome"]) == ("failed", "notGood")
        assert task["outputParameters"]["by"] == "gesture"
        asked()
        page.locator("[data-situation=prompt]").wait_for()
    finally:
        wearer.take_off()
    page.get_by_role("heading", name="Connection to glove-1 lost").wait_for()
    page.evaluate(STILL)
    fills_the_stage(page, "desk", "stop")
    assert_visible(page, "Complete by hand")
    keep(page, "work-lost")
