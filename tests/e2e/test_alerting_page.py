"""The page *Alerting*: a rule is tested and raises an Alert, a route sends it, the log shows it."""

import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage, type_slowly
from tests.kit.cell import Cell

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]

PHONE = {"width": 390, "height": 844}
REST = {"timeout": 120, "trust_env": False}

Keep = Callable[[Page, str], Path]
Accessible = Callable[[Page], None]


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """The services that the page asks."""
    shared_cell.run("context_broker")
    shared_cell.run("device_gateway", "alert_router", "task_orchestrator", "study", "webui")
    return shared_cell


@pytest.fixture
def receiver() -> Iterator[tuple[str, list[bytes]]]:
    """An HTTP server that keeps what it receives: its URL, and the bodies."""
    received: list[bytes] = []

    class Receive(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            received.append(self.rfile.read(int(self.headers["Content-Length"])))
            self.send_response(204)
            self.end_headers()

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            """Log nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Receive)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/in", received
    server.shutdown()
    server.server_close()
    thread.join()


class Oven:
    """A device that sends temperatures by HTTP."""

    def __init__(self, cell: Cell, name: str) -> None:
        self.url = cell.url("device_gateway")
        self.name = name
        description = {"kind": "sensor", "sensors": [{"name": "temperature", "unit": "CEL"}]}
        body = {"name": name, "description": description}
        self.token = httpx.post(f"{self.url}/devices", json=body, **REST).raise_for_status().json()["token"]

    def send(self, temperature: float, ago_s: float = 0.0) -> None:
        """Send one value."""
        message = {"type": "telemetry", "t": time.time() - ago_s, "values": {"temperature": temperature}}
        bearer = {"Authorization": f"Bearer {self.token}"}
        httpx.post(f"{self.url}/ingest/{self.name}", json=message, headers=bearer, **REST).raise_for_status()


def test_a_rule_is_tested_on_history_saved_and_raises_an_alert(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    oven = Oven(cell, "alerting-oven")
    for ago_s, temperature in ((3000, 20), (2000, 95), (1000, 20), (500, 99), (100, 20)):
        oven.send(temperature, ago_s)
    page = open_page("/admin/alerts")
    page.get_by_role("heading", name="Alerting").wait_for()
    type_slowly(page, "g", "n")
    page.get_by_role("textbox", name="Name", exact=True).fill("too-hot")
    page.get_by_role("textbox", name="Device (required)").fill("alerting-*")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("alert").filter(has_text="Correct one entry")).to_be_visible()
    page.get_by_role("textbox", name="Maximum").fill("80")
    page.get_by_label("Value", exact=True).select_option(label="alerting-oven · temperature")
    page.get_by_role("button", name="Test the rule").click()
    tested = page.get_by_role("region", name="Test on history")
    expect(tested.get_by_role("status")).to_have_text("5 values, 2 alerts")
    expect(tested.get_by_role("row")).to_have_count(3)
    accessible(page)
    page.get_by_role("button", name="Save").click()
    row = page.get_by_role("row", name="too-hot")
    expect(row).to_contain_text("Normal")
    oven.send(97)
    expect(row).to_contain_text("1 abnormal")
    now = page.get_by_role("region", name="Now")
    expect(now.get_by_role("row", name="alerting-oven · temperature")).to_contain_text("97")
    accessible(page)
    keep(page, "alerting-rule")
    # The other check has other numbers; what is saved is what the gateway has.
    page.get_by_label("Kind of check (required)").select_option(label="Silence")
    expect(page.get_by_role("textbox", name="Maximum")).to_have_count(0)
    page.get_by_role("textbox", name="No value for (s) (required)").fill("300")
    page.get_by_role("button", name="Save").click()
    expect(row).to_contain_text("Silence")
    saved = httpx.get(f"{oven.url}/rules/too-hot", **REST).json()["rule"]
    assert saved["check"] == {"type": "silence", "afterS": 300.0}
    for theme, language, viewport in (("dark", "de", None), ("light", "en", PHONE)):
        other = open_page("/admin/alerts?name=too-hot", theme=theme, language=language, viewport=viewport)
        other.get_by_role("table").first.wait_for()
        sideways = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
        assert other.evaluate(sideways) <= 0
        accessible(other)
        keep(other, f"alerting-rule-{theme}-{language}{'-phone' if viewport else ''}")
        other.context.close()
    page.get_by_role("button", name="Delete").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(row).to_have_count(0)


def test_a_route_sends_alerts_to_a_tested_channel_and_the_log_shows_them(
    cell: Cell,
    open_page: OpenPage,
    keep: Keep,
    accessible: Accessible,
    receiver: tuple[str, list[bytes]],
) -> None:
    url, received = receiver
    page = open_page("/admin/alerts?view=channels", forgives=("status of 409",))
    page.get_by_role("heading", name="Alerting").wait_for()
    page.get_by_role("button", name="Add a channel").click()
    page.get_by_role("textbox", name="Name", exact=True).fill("pager")
    page.get_by_label("Kind (required)").select_option(label="Webhook")
    page.get_by_role("textbox", name="URL (required)").fill(url)
    page.get_by_role("textbox", name="Secret").fill("a-secret-of-the-receiver")
    page.get_by_role("button", name="Save").click()
    page.get_by_role("button", name="Send a test message").click()
    expect(page.get_by_text("Accepted")).to_be_visible()
    assert b"Test of Handover" in received[0]
    # Saved again without its secret, it keeps that.
    page.get_by_role("textbox", name="Messages, at most (required)").fill("5")
    page.get_by_role("button", name="Save").click()
    shown = f"{cell.url('alert_router')}/channels"
    expect(page.get_by_role("status").filter(has_text="Saved")).to_be_visible()
    [channel] = [one for one in httpx.get(shown, **REST).json() if one["name"] == "pager"]
    assert (channel["channel"]["secret"], channel["channel"]["throttle"]["maximum"]) == ("**********", 5)
    accessible(page)
    keep(page, "alerting-channel")

    page.get_by_role("radio", name="Routes").click()
    page.get_by_role("button", name="Add a route").click()
    page.get_by_role("textbox", name="Name", exact=True).fill("night-shift")
    page.get_by_text("pager", exact=True).click()
    quiet = page.get_by_role("group", name="Quiet hours: wait until they have ended")
    quiet.get_by_role("button", name="Add").click()
    quiet.get_by_label("From (required)").fill("00:00")
    quiet.get_by_label("To (required)").fill("00:00")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("row", name="night-shift")).to_be_visible()
    which = page.get_by_role("region", name="Where would an alert go?")
    which.get_by_label("Severity").select_option(label="Critical")
    which.get_by_role("button", name="Show the routes").click()
    expect(which.get_by_role("listitem")).to_contain_text("Sent now")
    which.get_by_label("Severity").select_option(label="High")
    which.get_by_role("button", name="Show the routes").click()
    expect(which.get_by_role("listitem")).to_contain_text("Waits for the end of the quiet hours")
    accessible(page)
    keep(page, "alerting-route")

    page.get_by_role("radio", name="Channels").click()
    page.get_by_role("row", name="pager").click()
    page.get_by_role("button", name="Delete").click()
    asked = page.get_by_role("dialog")
    asked.get_by_role("button", name="Delete").click()
    expect(asked.get_by_role("alert")).to_contain_text('The route "night-shift" uses the channel "pager"')
    asked.get_by_role("button", name="Cancel").click()

    page.get_by_role("radio", name="Sent").click()
    expect(page.get_by_role("row", name="Test of Handover")).to_contain_text("Sent")
    accessible(page)
    keep(page, "alerting-sent")
    page.get_by_label("State").select_option(label="Failed")
    expect(page.get_by_text("Nothing was sent yet")).to_be_visible()
