"""Every page in both themes, three languages and all sizes: nothing truncated, no axe violations."""

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest
from playwright.sync_api import Page, TimeoutError, expect  # noqa: A004 - the one of Playwright

from handover_devices.device_client import DeviceClient
from tests.e2e.conftest import OpenPage, scan, type_slowly
from tests.kit.cell import Cell
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

SIZES = {"panel": {"width": 1280, "height": 800}, "desk": {"width": 1920, "height": 1080}}
PHONE = {"width": 390, "height": 844}
TABLET = {"width": 820, "height": 1180}
COLLIDING = """
    [...document.querySelectorAll("main :is([role=cell], [role=gridcell], [role=columnheader], th)")]
        .filter((cell) => cell.offsetParent !== null && cell.clientWidth > 1)
        .filter((cell) => (cell.closest("thead")?.clientWidth ?? 2) > 1)
        .filter((cell) => {
            const [row, own] = [cell.closest("[role=row], tr"), cell.getBoundingClientRect()];
            const isBeyond = row !== null && own.right > row.getBoundingClientRect().right + 1;
            return isBeyond || cell.scrollWidth > cell.clientWidth + 1;
        })
        .map((cell) => `${cell.textContent.slice(0, 40)}: ${cell.scrollWidth} in ${cell.clientWidth} px`)
"""
"""The cells of tables whose content is wider than they are, but for heads that only screen readers see."""
LOOKS = [("light", "en", "panel"), ("dark", "de", "panel"), ("light", "fi", "desk"), ("dark", "en", "desk")]
PAGES = {
    "start": "/",
    "work": "/work",
    "tasks": "/work/tasks",
    "processes": "/processes",
    "statistics": "/processes/statistics",
    "overview": "/cell",
    "robots": "/cell/robots",
    "control": "/cell/robots/ur10-1/control",
    "gloves": "/cell/gloves",
    "calibrate": "/cell/gloves/glove-1/calibrate",
    "test": "/cell/gloves/glove-1/test",
    "devices": "/cell/devices/page-arm",
    "sensors": "/cell/sensors",
    "events": "/cell/events",
    "health": "/care/health",
    "cases": "/care/cases?case=treadmill",
    "exercises": "/care/exercises",
    "people": "/admin/people",
    "services": "/admin/services",
    "alerting": "/admin/alerts?add=yes",
    "study": "/admin/studies",
    "alerts": "/alerts",
}
URDF = """<robot name="two">
<link name="base"><visual><geometry><box size="0.2 0.2 0.1"/></geometry></visual></link>
<link name="tip"><visual><geometry><cylinder radius="0.03" length="0.4"/></geometry></visual></link>
<joint name="lift" type="prismatic"><parent link="base"/><child link="tip"/><origin xyz="0 0 0.3"/>
<axis xyz="0 0 1"/><limit lower="0" upper="0.5" velocity="1" effort="9"/></joint></robot>"""


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests: they only look."""
    return shared_cell


@pytest.fixture
def screen(screen: Cell) -> Cell:
    """A screen with devices: an arm, a sensor out of its range, and one that was never connected."""
    if screen.runs("device_gateway"):
        return screen
    screen.extra["HANDOVER_ASSISTIVE_MACHINES"] = "wheelchair,treadmill"
    screen.extra |= {"HANDOVER_HUMANOID_MODEL": "coman", "HANDOVER_HUMANOID_FIFO": "false"}
    screen.run("device_gateway", "human_state", "assistive_devices", "whole_body_control")
    with httpx.Client(base_url=screen.url("device_gateway"), timeout=120, trust_env=False) as rest:

        def add(name: str, description: dict[str, Any], values: dict[str, float] | None = None) -> None:
            body = {"name": name, "description": description}
            token = rest.post("/devices", json=body).raise_for_status().json()["token"]
            if values is not None:
                message = {"type": "telemetry", "values": values}
                bearer = {"Authorization": f"Bearer {token}"}
                rest.post(f"/ingest/{name}", json=message, headers=bearer).raise_for_status()

        arm = rest.get("/templates").json()["panda"]
        joints = {joint["name"]: 0.0 for joint in arm["joints"]}
        add("page-arm", {**arm, "placement": {"location": "hall"}}, {**joints, "externalForce": 3})
        sensors = [{"name": "temperature", "unit": "CEL", "minimum": 0, "maximum": 250}]
        oven = {"kind": "sensor", "title": "Oven", "sensors": sensors, "placement": {"location": "kitchen"}}
        add("page-oven", oven, {"temperature": 260})
        add("page-away", {"kind": "sensor", "sensors": sensors})
    return screen


@pytest.fixture
def keep_sending(screen: Cell) -> Iterator[Callable[[str, dict[str, float]], None]]:
    """Let a device send the same values again and again until the test ends."""
    stopped = threading.Event()
    with ExitStack() as stack:

        def start(device: str, values: dict[str, float]) -> None:
            url = f"{screen.url('device_gateway')}/devices/{device}/token"
            token = httpx.post(url, timeout=120, trust_env=False).raise_for_status().json()["token"]
            client = DeviceClient("127.0.0.1", screen.ports["devices"], device, token)

            def send() -> None:
                while not stopped.wait(0.5):
                    client.send(values)

            client.start()
            stack.callback(client.stop)
            thread = threading.Thread(target=send)
            thread.start()
            stack.callback(thread.join)
            stack.callback(stopped.set)

        yield start


def settled(page: Page) -> None:
    """Wait until the page shows what it has to show."""
    page.locator("main h1, main h2").locator("visible=true").first.wait_for()
    page.evaluate("document.fonts.ready.then(() => true)")


def nothing_is_cut_off(page: Page) -> None:
    """Check that the page needs no scrolling sideways."""
    wider_by = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert wider_by <= 0, f"the page is {wider_by} px wider than the screen"


def navigation_is_whole(page: Page) -> None:
    """Check that every page of the navigation is visible without scrolling."""
    nav = page.get_by_role("navigation", name="Handover")
    wider_by = nav.evaluate("nav => nav.scrollWidth - nav.clientWidth")
    assert wider_by <= 0, f"{wider_by} px of the navigation are cut off"


@pytest.mark.nightly
@pytest.mark.usefixtures("screen")
def test_pages_fit_and_are_accessible_in_all_themes_languages_and_sizes(
    open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    for theme, language, size in LOOKS:
        page = open_page(theme=theme, language=language, viewport=SIZES[size])
        for name, path in PAGES.items():
            page.goto(path)
            settled(page)
            assert page.locator("html").get_attribute("lang") == language
            nothing_is_cut_off(page)
            navigation_is_whole(page)
            accessible(page)
            keep(page, f"{name}-{size}-{theme}-{language}")
        page.context.close()


@pytest.mark.nightly
@pytest.mark.usefixtures("screen")
def test_engineer_pages_fit_a_phone(
    open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    page = open_page(viewport=PHONE, has_touch=True, is_mobile=True)
    device = PAGES["devices"]
    devices = ("/cell/sensors", "/cell/devices", device, f"{device}?part=history", f"{device}?part=settings")
    for path in (
        "/",
        "/admin/services",
        "/cell/gloves/glove-1/calibrate",
        "/admin/people",
        "/cell/gloves/glove-1/test",
        "/admin/studies",
        "/care/health",
        "/care/cases",
        "/care/exercises",
        *devices,
    ):
        page.goto(path)
        settled(page)
        nothing_is_cut_off(page)
        accessible(page)
        keep(page, f"phone{re.sub('[^a-z]+', '-', path)}")


@pytest.mark.nightly
@pytest.mark.usefixtures("screen")
def test_sensors_show_rooms_and_what_needs_attention(
    open_page: OpenPage, keep: Callable[[Page, str], Path], keep_sending: Callable[..., None]
) -> None:
    keep_sending("page-oven", {"temperature": 260})
    page = open_page("/cell/sensors")
    oven = page.get_by_role("article", name="Oven")
    expect(oven).to_contain_text("Above 250 °C")
    expect(oven).to_contain_text("Out of range")
    expect(page.get_by_role("article", name="page-away")).to_contain_text("No value yet")
    assert [room.split()[0] for room in page.locator("main h2").all_inner_texts()] == [
        "hall",
        "kitchen",
        "No",
    ]
    page.get_by_role("radio", name="Needs attention").click()
    expect(page.get_by_role("article", name="page-away")).to_contain_text("Not connected")
    page.get_by_role("searchbox", name="Search").fill("kitchen temperature")
    expect(page.get_by_role("article")).to_have_count(1)
    keep(page, "sensors-attention")
    oven.get_by_role("link", name="History of Oven").click()
    expect(page.get_by_role("img", name=re.compile("Temperature: least 260 °C"))).to_be_visible()


@pytest.mark.nightly
@pytest.mark.usefixtures("screen")
def test_a_device_is_added_described_and_deleted_on_the_page(
    open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    page = open_page("/cell/devices", forgives=("status of 409", "status of 422"))
    page.get_by_role("button", name="Add a device").first.click()
    page.get_by_label("Template").select_option(label="Franka Emika Panda")
    name = page.get_by_role("textbox", name="Name", exact=True).first
    name.fill("page-oven")
    add = page.get_by_role("button", name="Add a device").last
    add.click()
    expect(page.get_by_role("alert")).to_contain_text('There is a device "page-oven" already')
    name.fill("page-robot")
    add.click()
    dialog = page.get_by_role("dialog", name="Token of page-robot")
    expect(dialog.get_by_role("textbox", name="Token", exact=True)).to_contain_text("hnd_device_")
    expect(dialog).to_contain_text("--device page-robot")
    accessible(page)
    dialog.get_by_role("button", name="I have stored the token").click()
    robot = page.get_by_role("region", name="page-robot")
    expect(robot.get_by_role("region", name="Values now")).to_contain_text("-2.897 … 2.897 rad")

    robot.get_by_role("radio", name="Commands").click()
    robot.get_by_label("Command", exact=True).select_option("grip")
    robot.get_by_role("textbox", name="Width (required)").fill("1")
    robot.get_by_role("button", name="Send “Grip”").click()
    expect(robot).to_contain_text("0.08")
    robot.get_by_role("textbox", name="Width (required)").fill("0.04")
    robot.get_by_role("button", name="Send “Grip”").click()
    ask = page.get_by_role("dialog", name="Move page-robot?")
    ask.get_by_role("button", name="Send “Grip”").click()
    expect(ask.get_by_role("alert")).to_contain_text("is not connected")
    ask.get_by_role("button", name="Cancel").click()

    robot.get_by_role("radio", name="3D model").click()
    with page.expect_file_chooser() as chooser:
        robot.get_by_role("button", name="Choose a URDF").click()
    chooser.value.set_files({"name": "two.urdf", "mimeType": "application/xml", "buffer": URDF.encode()})
    expect(robot.get_by_role("heading", name="Preview of two.urdf")).to_be_visible()
    expect(robot.get_by_role("application")).to_be_visible()
    keep(page, "device-model")
    robot.get_by_role("button", name="Save the URDF").click()
    expect(robot.get_by_role("rowheader", name="lift")).to_be_visible()

    robot.get_by_role("radio", name="Settings").click()
    robot.get_by_label("Room").fill("cell 4")
    robot.get_by_role("button", name="Save the description").click()
    robot.get_by_role("radio", name="Overview").click()
    expect(robot.get_by_text("cell 4")).to_be_visible()
    robot.get_by_role("radio", name="Settings").click()
    robot.get_by_role("button", name="Delete the device").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete the device").click()
    expect(page.get_by_role("row", name="page-robot")).to_have_count(0)
    expect(page.get_by_role("row", name="Oven")).to_be_visible()


@pytest.mark.nightly
@pytest.mark.usefixtures("screen")
def test_tables_do_not_overlap_on_a_tablet(open_page: OpenPage, keep: Callable[[Page, str], Path]) -> None:
    for language in ("fi", "de"):
        page = open_page(language=language, viewport=TABLET)
        for name in ("services", "overview", "alerts"):
            page.goto(PAGES[name])
            page.locator("[role=row], .empty-state").first.wait_for()
            nothing_is_cut_off(page)
            assert page.evaluate(COLLIDING) == []
            keep(page, f"tablet-{name}-{language}")
        page.goto("/processes")
        settled(page)
        nothing_is_cut_off(page)
        keep(page, f"tablet-processes-{language}")
        page.goto("/")
        settled(page)
        nothing_is_cut_off(page)
        keep(page, f"tablet-start-{language}")
        page.context.close()


@pytest.mark.nightly
@pytest.mark.usefixtures("screen")
def test_table_rows_are_tab_stops_and_their_times_are_not(open_page: OpenPage) -> None:
    page = open_page("/admin/services")
    rows = page.get_by_role("grid", name="Services").locator(".vgrid__line")
    rows.first.wait_for()
    assert page.locator("time[tabindex='0']").count() == 0
    assert page.locator("[role=row][tabindex='0']").count() == 1
    rows.first.focus()
    page.keyboard.press("ArrowDown")
    expect(rows.nth(1)).to_be_focused()
    shown = rows.nth(1).locator("time").first.evaluate("time => getComputedStyle(time, '::after').content")
    assert str(datetime.now(UTC).year) in shown, "the row with the focus shows the exact time"


@pytest.mark.nightly
@pytest.mark.usefixtures("screen")
def test_language_theme_and_name_are_stored(open_page: OpenPage) -> None:
    page = open_page("/", who="")
    page.get_by_role("button", name="Appearance, language and name").click()
    page.get_by_role("radio", name="Suomi").click()
    page.get_by_role("radio", name="Tumma").click()
    page.get_by_role("textbox", name="Nimi").fill("Aino")
    page.get_by_role("button", name="Sulje").click()
    page.reload()
    settled(page)
    assert page.locator("html").get_attribute("lang") == "fi"
    assert page.locator("html").get_attribute("data-theme") == "dark"
    page.get_by_role("button", name="Ulkoasu, kieli ja nimi").click()
    assert page.get_by_role("textbox", name="Nimi").input_value() == "Aino"


@pytest.mark.nightly
@pytest.mark.usefixtures("screen")
def test_the_keyboard_reaches_every_page_and_lists_its_keys(
    open_page: OpenPage, keep: Callable[[Page, str], Path]
) -> None:
    page = open_page("/")
    settled(page)
    type_slowly(page, "g", "?")
    listed = page.get_by_role("dialog", name="Keyboard shortcuts")
    listed.wait_for()
    keep(page, "keys")
    rows = dict(row.split("\n", 1) for row in listed.locator(".key-list__rows > div").all_inner_texts())
    page.keyboard.press("Escape")
    page.get_by_role("dialog").wait_for(state="detached")
    keys = {does.removeprefix("Go to "): key for key, does in rows.items() if does.startswith("Go to ")}
    documented = re.findall(r"`g` `(.)` \| ([^|]*?) \|", (REPOSITORY / "docs/how-to/keys.md").read_text())
    assert {name: key[-1] for name, key in keys.items()}.items() <= {
        name: key for key, name in documented
    }.items()
    assert len(set(keys.values())) == len(keys)
    for name, key in keys.items():
        assert re.fullmatch(r"g ?[a-z]", key), key

        def is_there(key: str = key, name: str = name) -> bool:
            if page.title() == f"{name} · Handover":
                return True
            type_slowly(
                page, "g", key[-1]
            )  # again where a busy page was slower than the two strokes may be apart
            page.wait_for_timeout(1000)
            return False

        wait_for(is_there, 180)

    page.get_by_role("button", name="Appearance, language and name").click()
    page.get_by_text("Keyboard navigation: g, then a letter").click()
    keep(page, "keys-setting")
    page.get_by_role("button", name="Close").click()
    here = page.url
    type_slowly(page, "g", "h")
    page.get_by_role("button", name="Show keyboard shortcuts").click()
    expect(listed).to_contain_text("Keyboard navigation is off")
    expect(listed).not_to_contain_text("Go to")
    assert page.url == here
    page.get_by_role("button", name="Close").click()
    page.get_by_role("button", name="Appearance, language and name").click()
    page.get_by_text("Keyboard navigation: g, then a letter").click()


SCANNED_PAGES = (
    *PAGES.values(),
    "/cell/robots/ur10-1",
    "/cell/gloves/glove-1",
    *(f"/admin/people?view={view}" for view in ("gestures", "users", "stations", "tokens")),
    "/processes/upload",
    "/work?glove=glove-1",
    "/admin/alerts?view=routes",
    "/care/exercises/vr",
)
ACTING = """
    [...document.querySelectorAll(
        "a[href], button, summary, select, input, textarea, "
        + "[role=button], [role=tab], [role=row], [role=application]"
    )].filter((one) => !one.disabled && one.offsetParent !== null && one.tabIndex >= 0)
"""
KIND = """
    (one) => [
        one.tagName, one.type ?? "", one.getAttribute("role") ?? "",
        ...[...one.classList].sort(),
        ...one.getAttributeNames().filter((name) => /^(data-|aria-haspopup)/.test(name)).sort(),
    ].join(" ")
"""
"""What an element is to the code that handles its keys: the same for all rows of a table, for example."""
KINDS = f"""
    () => {{
        window.ofKind = new Map();
        for (const one of {ACTING}) {{
            const kind = ({KIND})(one);
            if (!window.ofKind.has(kind)) window.ofKind.set(kind, one);
        }}
        return [...window.ofKind.keys()];
    }}
"""
FOCUS = """
    (kind) => {
        const one = window.ofKind.get(kind);
        one.focus();
        return document.activeElement === one ? one.outerHTML.slice(0, 200) : null;
    }
"""
STATE = """
    () => JSON.stringify([
        location.href,
        document.querySelectorAll("[role=dialog], [role=alertdialog], [role=menu], [role=listbox]").length,
        [...document.querySelectorAll(
            "[aria-expanded=true], [aria-selected=true], " +
            "[aria-checked=true], [aria-pressed=true], details[open]"
        )].map((one) => one.textContent.replace(/[0-9]+/g, "").slice(0, 12)),
        [...document.querySelectorAll("select")].map((one) => one.value),
        [...document.querySelectorAll("input[type=checkbox], input[type=radio]")].map((one) => one.checked),
        document.documentElement.dataset.theme,
    ])
"""
AFTER_SCAN = "() => new Promise((done) => setTimeout(() => requestAnimationFrame(() => done(true)), 60))"
"""Wait longer than a key waits for the next one of a scan: 50 ms, by a timer that is older than this one."""
SCANNED = ("gw7", "c1p", "4 c", "nsb")
MIN_KINDS = 25


@pytest.mark.nightly
@pytest.mark.usefixtures("screen")
def test_a_scan_acts_on_no_page(open_page: OpenPage) -> None:
    """One element of each kind gets a scan, each time another one, on the first four pages that have it."""
    acts: list[str] = []
    # A filter may get the text of a scan, and this cell has neither accounts nor an alert router.
    page = open_page("/", forgives=("status of 422", "status of 502"))
    page.on("request", lambda request: acts.append(request.url) if request.method != "GET" else None)
    scans: dict[str, int] = {}
    for path in SCANNED_PAGES:
        page.goto(path)
        settled(page)
        scan(page, "4006381333932")
        for kind in page.evaluate(KINDS):
            if scans.get(kind) == len(SCANNED) or (name := page.evaluate(FOCUS, kind)) is None:
                continue
            scans[kind] = scans.get(kind, 0) + 1
            text = SCANNED[(list(scans).index(kind) + scans[kind]) % len(SCANNED)]
            before = page.evaluate(STATE)
            scan(page, text)
            page.evaluate(AFTER_SCAN)
            if page.evaluate(
                "document.activeElement.matches('input[type=search], input[type=text], textarea')"
            ):
                continue  # it gets the text, and what it filters may change; the other test has its Enter
            assert page.evaluate(STATE) == before, f"{path}: a scan of {text!r} acts on {name}"
            assert acts == [], f"{path}: a scan of {text!r} on {name} asks for {acts}"
    assert len(scans) >= MIN_KINDS, list(scans)
    page.goto("/")
    page.get_by_role("link", name="Processes").first.focus()
    type_slowly(page, "x", "Enter")
    page.wait_for_url("**/processes*")


@pytest.mark.nightly
@pytest.mark.usefixtures("screen")
def test_a_scan_goes_into_the_field_that_has_the_input_and_does_not_submit(open_page: OpenPage) -> None:
    page = open_page("/processes")
    search = page.get_by_role("searchbox").first
    search.focus()
    scan(page, "4006381333932")
    expect(search).to_have_value("4006381333932")
    page.goto("/cell/devices")
    page.get_by_role("button", name="Add a device").first.click()
    name = page.get_by_role("textbox", name="Name", exact=True).first
    name.focus()
    scan(page, "4006381333932")
    page.evaluate(AFTER_SCAN)
    expect(name).to_have_value("4006381333932")
    expect(page.get_by_role("row", name="4006381333932")).to_have_count(0)


@pytest.mark.usefixtures("screen")
def test_nothing_is_loaded_from_other_hosts(open_page: OpenPage) -> None:
    fetched: set[str] = set()
    page = open_page("/")
    page.on("request", lambda request: fetched.add(request.url))
    for path in PAGES.values():
        page.goto(path)
        settled(page)
    ours = page.url.split("/")[2]
    elsewhere = {
        url for url in fetched if url.split("/")[2] != ours and not url.startswith(("data:", "blob:"))
    }
    assert not elsewhere


def started(cell: Cell) -> str:
    """Start a process that waits for a person, and return its id."""
    url = cell.url("task_orchestrator")
    body = {"definition": "bin-picking"}
    return str(httpx.post(f"{url}/processes", json=body, timeout=120).raise_for_status().json()["id"])


UNKNOWN = {
    "accounts/AuditView.tsx": [
        "/admin/people?view=audit&service=nope",
        "/admin/people?view=audit&outcome=nope",
    ],
    "alerting/AlertingPage.tsx": ["/admin/alerts?view=nope"],
    "alerting/MessagesView.tsx": ["/admin/alerts?view=sent&state=nope"],
    "alerting/SettingsView.tsx": ["/admin/alerts?name=nope", "/admin/alerts?add=nope"],
    "calibrate/Calibration.tsx": [
        "/cell/gloves/glove-1/calibrate?step=nope",
        "/cell/gloves/glove-1/calibrate?finger=nope",
    ],
    "cases/CasesPage.tsx": ["/care/cases?case=nope"],
    "cockpit/CockpitPage.tsx": ["/processes/statistics?view=nope"],
    "cockpit/processes/ProcessTable.tsx": [
        "/processes/statistics?state=nope",
        "/processes/statistics?involves=nope",
        "/processes/statistics?time=nope",
    ],
    "cockpit/query.ts": [
        "/processes/statistics?of=nope",
        "/processes/statistics?of=bin-picking&version=nope",
        "/processes/statistics?period=nope",
        "/processes/statistics?from=nope",
        "/processes/statistics?to=nope",
    ],
    "cockpit/statistics/HeatMap.tsx": ["/processes/statistics?of=bin-picking&heat=nope"],
    "cockpit/statistics/StatisticsView.tsx": ["/processes/statistics?of=bin-picking&element=nope"],
    "cell/RobotsPage.tsx": ["/cell/robots/nope", "/cell/robots/ur10-1/nope"],
    "devices/DevicePanel.tsx": ["/cell/devices/page-arm?part=nope"],
    "cell/overview/Overview.tsx": ["/cell?show=nope", "/cell?kind=nope"],
    "devices/DevicesPage.tsx": [
        "/cell/devices/nope",
        *(f"/cell/devices?{name}=nope" for name in ("add", "view", "kind")),
    ],
    "devices/history/HistoryPart.tsx": [
        f"/cell/devices/page-arm?part=history&{name}=nope" for name in ("values", "span", "time", "forecast")
    ],
    "devices/messages/MessagesPart.tsx": [
        f"/cell/devices/page-arm?part=messages&{name}=nope" for name in ("direction", "type")
    ],
    "cell/GlovesPage.tsx": ["/cell/gloves/nope/test", "/cell/gloves/glove-1/nope"],
    "health/HealthPage.tsx": ["/care/health?person=nope"],
    "health/HistoryCard.tsx": ["/care/health?value=nope", "/care/health?span=nope"],
    "humanoid/SessionCard.tsx": ["/care/exercises?person=nope", "/care/exercises?session=nope"],
    "people/GesturesView.tsx": ["/admin/people?person=nope"],
    "people/PeoplePage.tsx": ["/admin/people?view=nope"],
    "processes/address.ts": [
        "/processes/nope",
        "/processes/definition/nope",
        "/processes/nope/nope",
        "/processes/definition/nope/nope",
    ],
    "processes/definition/DefinitionPanel.tsx": [
        "/processes/definition/bin-picking?version=nope",
        "/processes/definition/bin-picking?version=999",
    ],
    "processes/list/ProcessList.tsx": [
        f"/processes?{name}=nope" for name in ("state", "of", "involves", "sort")
    ],
    "processes/process/ProcessPanel.tsx": ["/processes/PROCESS?view=nope", "/processes/PROCESS?task=nope"],
    "processes/timeline/chosen.ts": ["/processes/PROCESS?status=nope", "/processes/PROCESS?who=nope"],
    "sensors/SensorsBoard.tsx": ["/cell/devices?view=board&show=nope"],
    "study/StudyPage.tsx": ["/admin/studies?session=nope"],
    "alerts/list/AlertsPanel.tsx": [
        f"/alerts?{name}=nope" for name in ("alert", "group", "state", "severity", "category", "from")
    ],
    "cell/events/EventsPanel.tsx": ["/cell/events?level=nope", "/cell/events?source=nope"],
    "tasks/TaskList.tsx": [f"/work/tasks?{name}=nope" for name in ("show", "sort", "later")],
    "tasks/TasksPage.tsx": ["/work/tasks?task=nope"],
    "test/Accuracy.tsx": [
        "/cell/gloves/glove-1/test?part=accuracy&test=nope",
        "/cell/gloves/glove-1/test?part=accuracy&rounds=nope",
    ],
    "test/FreeTrial.tsx": ["/cell/gloves/glove-1/test?gesture=nope"],
    "test/GloveTest.tsx": ["/cell/gloves/glove-1/test?part=nope"],
    "work/WorkPage.tsx": ["/work?glove=nope"],
    "App.tsx": ["/nope", "/system/nope", "/system?tab=nope", "/care/exercises/nope"],
}
"""Addresses that name what does not exist, by the module that reads them."""

FREE_TEXT = {"find", "text", "filter", "where", "agent"}
"""Parameters that are searched for: what is not found is an empty list, and the field shows the text."""
NEEDS_ACCOUNTS = {
    "accounts/UsersView.tsx:user",
    "accounts/AuditView.tsx:who",
    "accounts/AuditView.tsx:action",
}
NEEDS_ACCOUNTS |= {f"accounts/AuditView.tsx:{name}" for name in ("resource", "from", "to")}
NEEDS_ACCOUNTS |= {f"devices/DevicesPage.tsx:{name}" for name in ("as", "name")}
"""Fields that show what they are asked for, and the users of a cell with accounts."""


def test_every_parameter_of_an_address_is_tried_with_a_name_that_does_not_exist() -> None:
    source = REPOSITORY / "webui" / "app" / "src"
    read = re.compile(r"(?:useQueryParameter|useChoice(?:<\w+>)?)\(\"(\w+)\"")
    parameters = {
        f"{path.relative_to(source).as_posix()}:{name}"
        for path in source.rglob("*.ts*")
        for name in read.findall(path.read_text())
    }
    tried = {
        f"{module}:{name}"
        for module, addresses in UNKNOWN.items()
        for address in addresses
        for name in parse_qs(urlsplit(address).query)
    }
    assert {
        parameter
        for parameter in parameters - tried - NEEDS_ACCOUNTS
        if parameter.split(":")[1] not in FREE_TEXT
    } == set()


@pytest.mark.nightly
@pytest.mark.timeout(1500)
@pytest.mark.usefixtures("screen")
def test_an_address_that_names_nothing_says_so_on_every_page(
    cell: Cell, open_page: OpenPage, keep: Callable[[Page, str], Path], accessible: Callable[[Page], None]
) -> None:
    process = started(cell)
    human_state = cell.url("human_state")
    consent = {
        "purposes": ["live", "history"],
        "ends": (datetime.now(UTC) + timedelta(days=1)).isoformat(),
        "givenBy": "a test",
    }
    for path, body in (("", {}), ("/consent", consent)):
        httpx.put(f"{human_state}/people/page-person{path}", json=body, timeout=120).raise_for_status()
    page = open_page("/", forgives=tuple(f"status of {status}" for status in (400, 404, 422, 502)))
    missed: list[str] = []
    for address in (one.replace("PROCESS", process) for group in UNKNOWN.values() for one in group):
        page.goto(address)
        said = page.locator("main").get_by_text(
            re.compile("nope|999|does not exist|not found|is unknown|cannot be read", re.IGNORECASE)
        )
        try:
            said.first.wait_for(state="attached")
        except TimeoutError:
            missed.append(f"{address}: {page.locator('main').inner_text()[:200]}")
            continue
        if page.get_by_role("button", name=re.compile("^(Take control|Start bin picking again)")).count():
            missed.append(f"{address}: offers to act on something else")
    assert missed == []
    for name, path in (("robot", "/cell/robots/nope/control"), ("view", "/processes/statistics?view=nope")):
        for theme, language, size in LOOKS:
            other = open_page(path, theme=theme, language=language, viewport=SIZES[size])
            other.get_by_text("nope").first.wait_for()
            accessible(other)
            keep(other, f"unknown-{name}-{theme}-{language}")
            other.context.close()
    page.goto("/cell/robots/nope/control")
    page.get_by_role("link", name="Show what there is").click()
    page.get_by_text("ur10-1").first.wait_for()
