"""The page Humanoid: the robot live, a throw, a replay, a stop, a session with its report; real processes."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from services.whole_body_control.tests.integration.conftest import HumanoidCell
from services.whole_body_control.tests.integration.people import THROW_S, catching_patient, resume
from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(600)]

WITHIN_S = 180.0
# Drawing in software takes time by the pixel; the picture still stays in sight beside its cards.
SMALL = {"width": 1000, "height": 640}


@pytest.fixture
def humanoid(cell: Cell, tmp_path: Path) -> Iterator[HumanoidCell]:
    """A screen with a humanoid that stands."""
    folder = tmp_path / "ports"
    cell.extra = {"HANDOVER_HUMANOID_PORTS_DIR": str(folder), "HANDOVER_HUMANOID_FIFO": "false"}
    made = HumanoidCell(cell, folder)
    try:
        made.start()
        cell.run("webui")
        yield made
    finally:
        made.end()


def is_ended(humanoid: HumanoidCell) -> bool:
    resume(humanoid)
    return bool(humanoid.state()["session"]["state"] == "ended")


def test_a_therapist_throws_stops_and_leads_a_session(
    humanoid: HumanoidCell,
    open_page: OpenPage,
    keep: Callable[[Page, str], Path],
    accessible: Callable[[Page], None],
) -> None:
    page = open_page("/care/exercises", viewport=SMALL, forgives=("status of 409", "status of 422"))
    picture = page.get_by_role("application", name=re.compile("coman-1 in 3D"))
    expect(picture).to_be_visible()
    expect(page.get_by_role("link", name="Exercises")).to_have_attribute("aria-current", "page")
    page.locator("summary", has_text="left_leg").click()
    expect(page.get_by_role("rowheader", name="LHipSag")).to_be_visible()

    gains = page.get_by_role("region", name="Gains")
    expect(gains).to_contain_text("These are the gains of the model.")
    arm = gains.get_by_role("group", name="left_arm")
    arm.get_by_role("slider", name="Stiffness").fill("1.2")
    expect(arm).to_contain_text("120% · 72 N m/rad")
    expect(gains).to_contain_text("not applied yet")
    gains.get_by_role("button", name="Apply the gains").click()
    expect(gains).to_contain_text("The joints have the chosen gains.", timeout=1000 * WITHIN_S)
    assert humanoid.state()["gains"]["left_arm"] == {"stiffness": 1.2, "damping": 1}
    keep(page, "humanoid-gains")
    gains.get_by_role("button", name="Return to the model's gains").click()
    expect(gains).to_contain_text("These are the gains of the model.", timeout=1000 * WITHIN_S)

    recordings = page.get_by_role("region", name="Recordings")
    recordings.get_by_role("textbox", name="Name (optional)").fill("first throw")
    recordings.get_by_role("button", name="Record").click()
    expect(recordings.get_by_role("button", name="End the recording")).to_be_visible()

    page.get_by_role("radio", name="Throw").click()
    act = page.get_by_role("button", name="Throw the ball")
    expect(act).to_be_visible()
    page.get_by_role("slider", name="Ahead").fill("2")
    act.click()
    expect(page.get_by_role("alert")).to_contain_text("farthest place on that line")
    page.get_by_role("slider", name="Ahead").fill("0.8")
    before = page.get_by_role("slider", name="To the left").input_value()
    box = picture.bounding_box()
    assert box is not None
    picture.locator("canvas").click(position={"x": 0.57 * box["width"], "y": 0.67 * box["height"]})
    expect(page.get_by_role("slider", name="To the left")).not_to_have_value(before)
    page.get_by_role("slider", name="Ahead").fill("0.8")
    page.get_by_role("slider", name="To the left").fill("0.1")
    thrown_s = float("-inf")

    def has_landed() -> bool:  # a hand keeps the ball when wishes are late on a slow machine: throw again
        nonlocal thrown_s
        now_s = humanoid.state()["t"]
        if now_s is not None and now_s - thrown_s > THROW_S:
            thrown_s = now_s
            act.click()
        return page.get_by_text(re.compile(r"cm off$")).is_visible()

    wait_for(has_landed, WITHIN_S, "the ball lands")
    expect(page.get_by_role("row", name=re.compile("centre of mass"))).to_be_visible()
    keep(page, "humanoid-throw")
    accessible(page)

    recordings.get_by_role("button", name="End the recording").click()
    recordings.get_by_role("button", name="Replay").click()
    replay = page.get_by_role("region", name="Replay of first throw")
    replay.get_by_role("button", name="Pause").click()
    replay.get_by_role("slider", name="Time").fill("1")
    expect(replay).to_contain_text(re.compile(r"1 of \d+(\.\d)? s"))
    expect(page.get_by_role("row", name=re.compile("centre of mass"))).to_be_visible()
    keep(page, "humanoid-replay")
    accessible(page)
    replay.get_by_role("button", name="Back to the robot").click()
    expect(replay).to_be_hidden()

    page.get_by_role("button", name="Stop", exact=True).click()
    expect(page.get_by_text(re.compile("^Stopped by"))).to_be_visible()
    act.click()
    expect(page.get_by_role("alert")).to_contain_text("reset it first")
    page.get_by_role("button", name="Release the stop").click()
    expect(page.get_by_text("Stop: it finishes its step")).to_be_visible()

    with catching_patient(humanoid):
        page.get_by_role("textbox", name="Person (optional)").fill("anna")
        page.get_by_role("slider", name="Goal: throws").fill("1")
        page.get_by_role("button", name="Begin Juggling").click()
        expect(page.get_by_role("button", name="End the session")).to_be_visible()
        wait_for(lambda: is_ended(humanoid), WITHIN_S, "the goal is reached")
    sessions = page.get_by_role("region", name="Sessions and progress")
    expect(sessions).to_contain_text("goal reached")
    sessions.get_by_role("button").first.click()
    expect(page.get_by_role("region", name="Report")).to_contain_text("Caught")
    sessions.get_by_label("Person").select_option("anna")
    expect(page.get_by_role("img", name=re.compile("^Week .*: sessions 1"))).to_be_visible()
    keep(page, "humanoid-session")
    accessible(page)
    sessions.get_by_role("button", name="Delete all sessions").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete all sessions").click()
    expect(sessions).to_contain_text("No session yet")
