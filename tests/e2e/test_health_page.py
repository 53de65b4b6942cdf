"""The Health page: consent first, live values and waveforms, what is recorded, deletion."""

import re
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]

PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    return shared_cell


@pytest.fixture
def health(cell: Cell) -> Cell:
    """A screen with human state, and nobody in it."""
    cell.run("context_broker")
    cell.run("webui", "human_state")
    with httpx.Client(base_url=cell.url("human_state"), timeout=120, trust_env=False) as rest:
        for person in rest.get("/people").raise_for_status().json():
            rest.delete(f"/people/{person['person']}").raise_for_status()
    return cell


@pytest.mark.usefixtures("health")
def test_a_person_consents_is_seen_live_and_is_deleted(
    open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    page = open_page("/care/health")
    expect(page.get_by_role("link", name="Health")).to_be_visible()
    expect(page.get_by_text("No person yet")).to_be_visible()
    page.get_by_role("button", name="Add a person").click()
    give = page.get_by_role("button", name="Give the consent")
    page.get_by_role("textbox", name="Name of the person").fill("aino")
    give.click()
    expect(page.get_by_text("Give an age from 14 to 100 years")).to_be_visible()
    page.get_by_role("textbox", name="Age in years").fill("40")
    page.get_by_text("Values are kept for the time of retention").click()
    page.get_by_text("The heart rate limits robots").click()
    keep(page, "health-consent")
    accessible(page)
    give.click()

    recorded = page.get_by_role("region", name="What is recorded")
    expect(recorded.get_by_role("listitem").filter(has_text=re.compile("^History"))).to_contain_text("on")
    expect(recorded.get_by_role("listitem").filter(has_text="Context broker")).to_contain_text("off")
    page.get_by_role("button", name="Start a simulated sensor").click()
    vital = page.get_by_role("region", name="Vital signs")
    rate = vital.get_by_role("listitem").filter(has_text="Heart rate")
    expect(rate).to_contain_text("Valid")
    assert 40 <= int(rate.get_by_role("status").inner_text()) <= 120
    expect(page.get_by_role("img", name="ECG, the last 10 s").locator("canvas")).to_be_visible()
    expect(page.get_by_role("img", name="Pressure map of 3 by 4 cells")).to_be_visible()
    expect(page.get_by_role("region", name="Speed limit")).to_contain_text("No robot is bound")
    expect(page.get_by_role("img", name="Heart rate: least")).to_be_visible()
    looked = page.get_by_role("region", name="Who looked at this data")
    expect(looked).to_contain_text("Somebody on this machine stored the consent")
    accessible(page)
    keep(page, "health")
    for theme, language, size in (("dark", "de", None), ("light", "fi", PHONE)):
        other = open_page("/care/health", theme=theme, language=language, viewport=size)
        expect(other.locator(".vital-sign[data-trust=valid]").first).to_be_visible()
        wider = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
        assert other.evaluate(wider) <= 0
        accessible(other)
        keep(other, f"health-{theme}-{language}")
        other.context.close()

    page.get_by_role("button", name="Withdraw the consent").click()
    page.get_by_role("dialog").get_by_role("button", name="Withdraw the consent").click()
    expect(page.get_by_text("The consent was withdrawn")).to_be_visible()
    expect(vital).to_have_count(0)
    page.get_by_role("button", name="Delete the person").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete the person").click()
    expect(page.get_by_text("No person yet")).to_be_visible()
