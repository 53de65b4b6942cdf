"""Signing in with Chromium: the link of the owner, a wrong password, signing out."""

from collections.abc import Iterator

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect

from tests.e2e.conftest import PANEL, SCREENSHOTS, TIMEOUT_MS
from tests.kit.cell import Cell, new_cell
from webui.tests.integration.test_signing_in import PASSWORD, set_up

pytestmark = pytest.mark.slow


@pytest.fixture
def own_cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with new_cell(tmp_path_factory.mktemp("signed")) as made:
        made.start("context_broker", "accounts", "webui", within_s=90)
        yield made


def test_the_owner_joins_signs_out_and_signs_in(browser: Browser, own_cell: Cell) -> None:
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    secret = set_up(own_cell)
    page = browser.new_page(viewport=PANEL, locale="en")
    page.set_default_timeout(TIMEOUT_MS)
    page.goto(f"{own_cell.url('webui')}/join#{secret}")
    expect(page.get_by_role("heading", name="Create the owner's account")).to_be_visible()
    page.get_by_label("Name", exact=True).fill("Olga")
    page.get_by_label("New password").fill(PASSWORD)
    page.screenshot(path=SCREENSHOTS / "join.png")
    page.get_by_role("button", name="Create the account").click()
    page.get_by_role("button", name="Account of Olga").click()
    page.screenshot(path=SCREENSHOTS / "account.png")
    page.get_by_role("button", name="Sign out").click()
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
    page.get_by_label("Name", exact=True).fill("Olga")
    page.get_by_label("Password", exact=True).fill("not the password")
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("alert")).to_contain_text("The name or the password is wrong")
    page.screenshot(path=SCREENSHOTS / "sign-in.png")
    box = page.get_by_role("button", name="Sign in").bounding_box()
    assert box is not None
    assert box["height"] >= 64, "for gloved hands"
    page.get_by_label("Password", exact=True).fill(PASSWORD)
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("button", name="Account of Olga")).to_be_visible()
    page.close()


@pytest.mark.nightly
def test_an_admin_invites_a_person_who_may_then_drive_two_robots(browser: Browser, own_cell: Cell) -> None:
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    devices = [f"urn:ngsi-ld:Device:demo:{name}" for name in ("ur10-1", "nao-1", "glove-1")]
    for device in devices:
        create(own_cell, {"id": device, "type": "Device"})
    page = browser.new_page(viewport=PANEL, locale="en")
    page.set_default_timeout(TIMEOUT_MS)
    page.goto(f"{own_cell.url('webui')}/people?view=users")
    expect(page.get_by_text("handover accounts set-up")).to_be_visible()
    page.screenshot(path=SCREENSHOTS / "people-local.png")
    join(page, own_cell, set_up(own_cell), "Olga")
    page.goto(f"{own_cell.url('webui')}/people?view=users")
    page.get_by_role("button", name="Invite a person").click()
    page.get_by_role("dialog").get_by_label("Name", exact=True).fill("Vera")
    page.get_by_role("dialog").get_by_role("button", name="Invite a person").click()
    link = page.get_by_role("textbox", name="Link for the invitation").input_value()
    page.screenshot(path=SCREENSHOTS / "people-link.png")
    page.get_by_role("button", name="Close").click()

    operator = browser.new_context(viewport=PANEL, locale="en").new_page()
    operator.set_default_timeout(TIMEOUT_MS)
    join(operator, own_cell, link.rsplit("#", 1)[1], "Vera")
    operator.goto(f"{own_cell.url('webui')}/people")
    expect(operator.get_by_role("radio", name="My sessions")).to_be_visible()
    expect(operator.get_by_role("radio", name="Users")).to_have_count(0)
    operator.goto(f"{own_cell.url('webui')}/people?view=users")
    expect(operator.get_by_text('You do not have the permission "Manage people"')).to_be_visible()
    expect(operator.get_by_text("These administrators can grant it: Olga.")).to_be_visible()
    operator.screenshot(path=SCREENSHOTS / "people-operator.png")

    page.reload()
    page.get_by_role("row", name="Vera").click()
    page.get_by_role("button", name="Add a role").click()
    page.get_by_role("dialog").get_by_label("Role", exact=True).select_option("engineer")
    page.get_by_role("dialog").get_by_label("For", exact=True).select_option("some")
    for name in ("ur10-1", "nao-1"):
        page.get_by_role("dialog").get_by_text(name).click()
    page.screenshot(path=SCREENSHOTS / "people-grant.png")
    page.get_by_role("dialog").get_by_role("button", name="Add a role").click()
    expect(page.get_by_role("row", name="Vera")).to_contain_text("Engineer (ur10-1, nao-1)")
    page.screenshot(path=SCREENSHOTS / "people-users.png")
    page.get_by_role("button", name="End all sessions").click()
    expect(page.get_by_text("No open session.")).to_be_visible()
    expect(operator.get_by_role("heading", name="Sign in")).to_be_visible()
    operator.context.close()

    page.goto(f"{own_cell.url('webui')}/people?view=tokens")
    page.get_by_role("button", name="Issue a token").click()
    page.get_by_role("dialog").get_by_label("Name", exact=True).fill("Robot of the night")
    page.get_by_role("dialog").get_by_role("button", name="Issue a token").click()
    token = page.get_by_role("textbox", name="Token of Robot of the night").input_value()
    assert token.startswith("hnd_script_")
    page.get_by_role("button", name="Close").click()
    expect(page.get_by_role("row", name="Robot of the night")).to_be_visible()
    page.screenshot(path=SCREENSHOTS / "people-tokens.png")
    page.goto(f"{own_cell.url('webui')}/people?view=audit&service=accounts&action=token")
    expect(page.get_by_role("row", name="Token issued, Olga")).to_be_visible()
    page.get_by_role("button", name="Verify").click()
    expect(page.get_by_text("records are intact")).to_be_visible()
    page.screenshot(path=SCREENSHOTS / "people-audit.png")
    page.close()


def create(cell: Cell, entity: dict[str, str]) -> None:
    answer = httpx.post(f"{cell.url('context_broker')}/ngsi-ld/v1/entities", json=entity, timeout=60)
    assert answer.status_code == 201, answer.text


def join(page: Page, cell: Cell, secret: str, name: str) -> None:
    page.goto(f"{cell.url('webui')}/join#{secret}")
    page.get_by_label("Name", exact=True).fill(name)
    page.get_by_label("New password").fill(PASSWORD)
    page.get_by_role("button", name="Create the account").click()
    expect(page.get_by_role("button", name=f"Account of {name}")).to_be_visible()
