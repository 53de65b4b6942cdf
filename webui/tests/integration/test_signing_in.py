"""Signing in through the page server: cookie, CSRF token, access tokens for services, and their end."""

import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import httpx
import orjson
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from tests.kit.cell import Cell, new_cell
from tests.kit.waiting import wait_for

pytestmark = pytest.mark.slow

PASSWORD = "correct horse battery"


def set_up(cell: Cell) -> str:
    """End local mode as an engineer does; return the secret of the owner's link."""
    done = subprocess.run(
        [sys.executable, "-m", "handover_cell", "accounts", "set-up"],
        env=cell.environment,
        cwd=cell.data_dir,
        capture_output=True,
        text=True,
        check=True,
        stdin=subprocess.DEVNULL,
    )
    return done.stdout.rsplit("#", 1)[1].strip()


class Browser:
    """A browser: keeps cookies, and sends the CSRF token as the page does."""

    def __init__(self, cell: Cell) -> None:
        self.http = httpx.Client(
            base_url=cell.url("webui"),
            timeout=120,
            trust_env=False,
            limits=httpx.Limits(max_keepalive_connections=0),
        )
        self.session: dict[str, Any] = {}

    def begin(self, path: str, body: dict[str, Any]) -> httpx.Response:
        answer = self.http.post(path, json=body)
        if answer.is_success:
            self.session = answer.json()
        return answer

    def send(self, method: str, path: str, body: Any = None) -> httpx.Response:
        headers = {"X-CSRF-Token": self.session.get("csrf") or ""}
        return self.http.request(method, path, json=body, headers=headers)

    def cookies(self) -> str:
        return "; ".join(f"{name}={value}" for name, value in self.http.cookies.items())


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with new_cell(tmp_path_factory.mktemp("cell")) as made:
        made.extra["HANDOVER_TRUSTED_PROXIES"] = "127.0.0.1"
        made.extra["HANDOVER_SESSION_BOUND"] = "true"
        made.start("accounts", "webui", "study", within_s=90)
        yield made


@pytest.fixture(scope="module")
def owner(cell: Cell) -> Browser:
    local = Browser(cell)
    view = local.http.get("/api/session").json()
    assert (view["hasAccounts"], view["user"]["isLocal"]) == (False, True)
    assert local.http.get("/api/accounts/users").json() == [], "in local mode nobody signs in"
    refused = local.begin("/api/session", {"name": "Olga", "password": PASSWORD})
    assert refused.status_code == 409, refused.text
    assert "handover secure" in refused.json()["detail"]
    link = set_up(cell)
    wait_for(lambda: local.http.get("/api/accounts/users").status_code == 401)
    browser = Browser(cell)
    assert browser.begin("/api/session/link", {"link": link}).json()["purpose"] == "owner"
    used = browser.begin("/api/session/link-use", {"link": link, "name": "Olga", "password": PASSWORD})
    assert used.status_code == 200, used.text
    cookie = used.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    return browser


def invited(cell: Cell, owner: Browser, name: str, *grants: dict[str, str]) -> Browser:
    link = owner.send("POST", "/api/accounts/invitations", {"grants": list(grants)}).json()["link"]
    browser = Browser(cell)
    body = {"link": link, "name": name, "password": PASSWORD}
    assert browser.begin("/api/session/link-use", body).status_code == 200
    return browser


def read_to_end(live: ClientConnection) -> None:
    while True:
        live.recv(timeout=60)


@pytest.mark.nightly
def test_the_cookie_gives_a_user_their_rights_at_the_services(cell: Cell, owner: Browser) -> None:
    anna = invited(cell, owner, "Anna", {"role": "viewer", "resource": "*"})
    rosa = invited(cell, owner, "Rosa", {"role": "researcher", "resource": "*"})
    assert anna.session["user"]["name"] == "Anna"
    wait_for(lambda: rosa.send("GET", "/api/study/sessions").status_code == 200)
    assert anna.send("GET", "/api/study/sessions").status_code == 403
    assert anna.send("GET", "/api/accounts/users").status_code == 403
    assert anna.send("GET", "/api/accounts/me").json()["name"] == "Anna"
    # The study answers 503 until it follows the revocations of accounts.
    wait_for(lambda: anna.send("POST", "/api/study/sessions", {}).status_code == 403)
    assert httpx.get(f"{cell.url('study')}/sessions", timeout=120).status_code == 401


def test_behind_a_proxy_the_cookie_is_secure_and_the_session_has_the_address_of_the_client(
    cell: Cell, owner: Browser
) -> None:
    invited(cell, owner, "Petra")
    browser = Browser(cell)
    browser.http.headers.update({"X-Forwarded-For": "203.0.113.9", "X-Forwarded-Proto": "https"})
    signed_in = browser.http.post("/api/session", json={"name": "Petra", "password": PASSWORD})
    cookie = signed_in.headers["set-cookie"]
    assert cookie.startswith("__Host-handover_")
    assert "; Secure" in cookie
    headers = {"Cookie": cookie.partition(";")[0]}
    sessions = browser.http.get("/api/accounts/me/sessions", headers=headers).json()
    assert {session["address"] for session in sessions} == {"127.0.0.1", "203.0.113.9"}


def test_a_password_is_changed_with_the_address_of_the_client(cell: Cell, owner: Browser) -> None:
    paula = invited(cell, owner, "Paula")
    guess = {"current": "a wrong password", "new": "a different sentence"}
    assert paula.http.put("/api/session/password", json=guess).status_code == 403, "no CSRF token"
    assert paula.send("PUT", "/api/session/password", guess).json()["title"] == "Wrong password"
    path = "/api/accounts/audit?action=passwordChange.failed"
    assert [one["text"] for one in owner.send("GET", path).json()] == ["from 127.0.0.1"]
    known = {"current": PASSWORD, "new": "a different sentence"}
    assert paula.send("PUT", "/api/session/password", known).status_code == 204
    assert paula.send("GET", "/api/accounts/me").status_code == 200
    token = owner.send("POST", "/api/accounts/tokens", {"kind": "script", "name": "plotter"}).json()["token"]
    script = {"Authorization": f"Bearer {token}"}
    refused = httpx.put(f"{cell.url('webui')}/api/session/password", json=known, headers=script, timeout=120)
    assert refused.status_code == 409


def test_a_cookie_without_the_csrf_token_changes_nothing(owner: Browser) -> None:
    refused = owner.http.post("/api/accounts/invitations", json={})
    assert (refused.status_code, refused.json()["title"]) == (403, "No CSRF token")
    wrong = owner.http.post("/api/accounts/invitations", json={}, headers={"X-CSRF-Token": "x" * 43})
    assert wrong.status_code == 403
    assert owner.send("POST", "/api/accounts/invitations", {}).status_code == 201


def test_a_stolen_cookie_is_of_no_use_to_another_page(cell: Cell, owner: Browser) -> None:
    csrf = {"X-CSRF-Token": owner.session["csrf"]}
    for foreign in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}):
        assert owner.http.get("/api/accounts/me", headers=foreign).status_code == 403
        sent = owner.http.post("/api/accounts/invitations", json={}, headers={**csrf, **foreign})
        assert sent.status_code == 403
    url = cell.url("webui").replace("http", "ws") + "/api/live"
    with pytest.raises(InvalidStatus):
        connect(
            url,
            proxy=None,
            origin="http://evil.example",  # type: ignore[arg-type]
            additional_headers={"Cookie": owner.cookies()},
        ).close()


def test_a_stolen_cookie_is_of_no_use_at_another_address(cell: Cell, owner: Browser) -> None:
    carla = invited(cell, owner, "Carla", {"role": "viewer", "resource": "*"})
    stolen = {"Cookie": carla.cookies(), "X-Forwarded-For": "203.0.113.66"}
    thief = httpx.Client(base_url=cell.url("webui"), headers=stolen, timeout=120, trust_env=False)
    with thief:
        refused = thief.get("/api/accounts/me")
        assert (refused.status_code, refused.json()["detailCode"]) == (401, "session.other_address")
        view = thief.get("/api/session").json()
        assert (view["user"], view["csrf"]) == (None, None)
    url = cell.url("webui").replace("http", "ws") + "/api/live"
    with pytest.raises(InvalidStatus):
        connect(url, proxy=None, additional_headers=stolen).close()
    assert carla.send("GET", "/api/accounts/me").status_code == 200, "her own session continues"


def test_a_cookie_moves_a_robot_only_with_the_right_and_from_our_own_page(cell: Cell, owner: Browser) -> None:
    url = cell.url("webui").replace("http", "ws") + "/api/trajectory-tool/robots/ur10-1/control"
    own: Any = cell.url("webui")
    robot = {"role": "engineer", "resource": "urn:ngsi-ld:Device:demo:ur10-1"}
    driver, viewer = invited(cell, owner, "Dirk", robot), invited(cell, owner, "Vera", {"role": "viewer"})

    def code(browser: Browser, address: str, **options: Any) -> int | None:
        cookie = {"Cookie": browser.cookies()}
        with connect(address, proxy=None, additional_headers=cookie, **options) as control:
            with pytest.raises(ConnectionClosed) as closed:
                read_to_end(control)
            return closed.value.rcvd.code if closed.value.rcvd is not None else None

    wait_for(lambda: driver.send("GET", "/api/accounts/me").status_code == 200)
    assert code(driver, url) == 4403, "a request without Origin is not from our page"
    assert code(driver, url, origin=own) == 4502, "the trajectory tool is not running here"
    for browser, address in ((viewer, url), (driver, url.replace("ur10-1", "ur10-2"))):
        with pytest.raises(InvalidStatus):
            connect(address, proxy=None, origin=own, additional_headers={"Cookie": browser.cookies()}).close()


def test_signing_out_ends_the_session_for_requests_and_for_the_live_page(cell: Cell, owner: Browser) -> None:
    bela = invited(cell, owner, "Bela", {"role": "viewer", "resource": "*"})
    url = cell.url("webui").replace("http", "ws") + "/api/live"
    with pytest.raises(InvalidStatus):
        connect(url, proxy=None).close()
    with connect(url, proxy=None, additional_headers={"Cookie": bela.cookies()}) as live:
        assert orjson.loads(live.recv(timeout=60))["type"] == "snapshot"
        stolen = bela.cookies()
        assert bela.send("DELETE", "/api/session").json() == {"location": None}
        with pytest.raises(ConnectionClosed) as closed:
            read_to_end(live)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 4401
    replayed = httpx.get(
        f"{cell.url('webui')}/api/accounts/me", headers={"Cookie": stolen}, timeout=120, trust_env=False
    )
    assert replayed.status_code == 401


def settings_of(database: Path, subject: str) -> int:
    with closing(sqlite3.connect(database)) as connection:
        query = "SELECT count(*) FROM webui_user_settings WHERE subject = ?"
        return int(connection.execute(query, [subject]).fetchone()[0])


def test_a_deleted_user_is_signed_out(cell: Cell, owner: Browser) -> None:
    chris = invited(cell, owner, "Chris", {"role": "researcher", "resource": "*"})
    wait_for(lambda: chris.send("GET", "/api/study/sessions").status_code == 200)
    users = owner.send("GET", "/api/accounts/users").json()
    subject = next(user["subject"] for user in users if user["name"] == "Chris")
    assert chris.send("PUT", "/api/user-settings/control.panels", {"order": []}).status_code == 204
    database = cell.data_dir / "webui.db"
    assert settings_of(database, subject) == 1
    assert owner.send("DELETE", f"/api/accounts/users/{subject}").status_code == 200
    assert settings_of(database, subject) == 0
    wait_for(lambda: chris.send("GET", "/api/study/sessions").status_code == 401, within_s=5)
    assert chris.http.get("/api/session").json()["user"] is None


def test_what_accounts_acknowledged_survives_its_end(cell: Cell, owner: Browser) -> None:
    dora = invited(cell, owner, "Dora")
    cell.restart("accounts")
    assert dora.send("GET", "/api/accounts/me").json()["name"] == "Dora"
    assert Browser(cell).begin("/api/session", {"name": "Dora", "password": PASSWORD}).status_code == 200
    assert owner.send("GET", "/api/accounts/audit/verification").json()["fault"] is None


def test_too_many_attempts_are_answered_with_the_time_to_wait(cell: Cell, owner: Browser) -> None:
    wrong = {"name": "Nobody", "password": "wrong password"}
    answers = [Browser(cell).begin("/api/session", wrong)]
    while answers[-1].status_code == 401 and len(answers) < 20:  # delays double; a hash may take long here
        answers.append(Browser(cell).begin("/api/session", wrong))
    assert answers[0].status_code == 401
    assert answers[-1].status_code == 429
    assert int(answers[-1].headers["retry-after"]) >= 1


@pytest.mark.nightly
def test_a_viewer_who_opens_many_websockets_keeps_nobody_out(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    with new_cell(tmp_path_factory.mktemp("cell")) as cell, ExitStack() as stack:
        cell.extra["HANDOVER_HTTP_MAX_WEBSOCKETS_PER_SESSION"] = "6"
        cell.start("context_broker", "accounts", "trajectory_tool", "webui", within_s=90)
        owner = Browser(cell)
        owner.begin("/api/session/link-use", {"link": set_up(cell), "name": "Olga", "password": PASSWORD})
        viewer = invited(cell, owner, "Vera", {"role": "viewer", "resource": "*"})
        other = invited(cell, owner, "Otto", {"role": "viewer", "resource": "*"})
        driver = invited(cell, owner, "Dora", {"role": "engineer", "resource": "*"})
        url = cell.url("webui").replace("http", "ws", 1)

        def live(browser: Browser, path: str = "/api/live") -> ClientConnection:
            headers = {"Cookie": browser.cookies()}
            opened = connect(
                f"{url}{path}",
                origin=cell.url("webui"),  # type: ignore[arg-type]
                additional_headers=headers,
                proxy=None,
                open_timeout=60,
            )
            return stack.enter_context(opened)

        for _ in range(6):
            assert live(viewer).recv(timeout=60)
        for _ in range(20):
            with pytest.raises(InvalidStatus):
                live(viewer)
        assert live(other).recv(timeout=60)
        control = live(driver, "/api/trajectory-tool/robots/ur10-1/control")
        assert control.recv(timeout=60)


def test_an_admin_who_changes_the_own_grants_is_not_refused_for_a_moment(cell: Cell, owner: Browser) -> None:
    """Accounts knows the new grants before the page server, which has an older token."""
    me = owner.send("GET", "/api/accounts/me").json()["subject"]
    grant = {"subject": me, "role": "viewer", "resource": "Device:robot-*"}
    for number in range(10):
        granted = owner.send("POST", "/api/accounts/grants", grant | {"resource": f"Device:{number}"})
        assert granted.status_code == 201, granted.text
        assert owner.send("GET", "/api/accounts/users").status_code == 200
        removed = owner.send("DELETE", f"/api/accounts/grants/{granted.json()['id']}")
        assert removed.status_code == 204, removed.text
        assert owner.send("GET", "/api/accounts/users").status_code == 200
