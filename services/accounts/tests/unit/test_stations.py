"""Stations: an engineer signs a screen in, people join it and leave it, and the audit names the method."""

import asyncio
from typing import Any

import pytest

from handover.security.permissions import Grant, Permission, Role
from handover_accounts.storage.stations import joined
from services.accounts.tests.unit.conftest import HOME, Accounts

ANNA, BEN = "urn:ngsi-ld:Person:demo:anna", "urn:ngsi-ld:Person:demo:ben"
PINS = {"Anna": "480215", "Ben": "731946"}


class Line:
    """A station with a glove, signed in by an engineer, and two people."""

    def __init__(self, accounts: Accounts) -> None:
        self.accounts = accounts
        self.station: dict[str, Any] = {}
        self.session = ""
        self.subjects: dict[str, str] = {}

    async def prepare(self) -> "Line":
        owner = await self.accounts.owner()
        for name, person in (("Anna", ANNA), ("Ben", BEN)):
            session = await self.accounts.member(name)
            subject = self.accounts.caller(await self.accounts.token_of(session)).subject
            self.subjects[name] = subject
            for path, body in (
                (f"/users/{subject}", {"person": person}),
                (f"/users/{subject}/identifiers/badge", {"value": f"B-{name}-1"}),
                (f"/users/{subject}/identifiers/pin", {"value": PINS[name]}),
                (f"/users/{subject}/identifiers/gesture", {"value": f"{name} hello"}),
            ):
                method = "PATCH" if "person" in body else "PUT"
                answer = await self.accounts.call(method, path, body, token=owner)
                assert answer.is_success, answer.text
        await self.accounts.member("Erin", ("engineer", "*"))
        self.session = await self.sign_in()
        return self

    async def sign_in(self) -> str:
        engineer = str((await self.accounts.sign_in("Erin")).json()["session"])
        if not self.station:
            body = {"name": "Station 1", "gloves": ["glove-1", "glove-2"]}
            token = await self.accounts.token_of(engineer)
            answer = await self.accounts.call("POST", "/stations", body, token=token)
            assert answer.status_code == 201, answer.text
            self.station = answer.json()
        body = {"session": engineer, "station": self.station["subject"], "address": HOME, "device": "Panel"}
        opened = await self.accounts.as_page("POST", "/station-sessions", body)
        assert opened.status_code == 201, opened.text
        ended = await self.accounts.as_page("POST", "/session-tokens", {"session": engineer})
        assert ended.status_code == 401, "the engineer is signed out at this screen"
        return str(opened.json()["session"])

    async def screen(self, method: str, path: str, body: Any = None) -> Any:
        return await self.accounts.call(method, path, body, token=await self.accounts.token_of(self.session))

    async def join(self, method: str, value: str) -> int:
        body = {"method": method, "value": value}
        return int((await self.screen("PUT", "/me/station/person", body)).status_code)

    async def there(self) -> str | None:
        present = (await self.screen("GET", "/me/station")).json()["joined"]
        return None if present is None else str(present["name"])

    async def gesture(self, gesture: str, glove: str = "glove-1") -> None:
        body = {"glove": glove, "gesture": gesture}
        assert (await self.accounts.as_page("POST", "/station-joins", body)).status_code == 204

    async def records(self, action: str) -> list[dict[str, Any]]:
        found = await self.accounts.call("GET", "/audit", token=await self.accounts.owner())
        return [one for one in found.json() if one["action"] == action]


@pytest.fixture
async def line(accounts: Accounts) -> Line:
    return await Line(accounts).prepare()


async def test_a_person_joins_by_badge_qr_code_or_pin_and_the_station_acts_in_their_name(line: Line) -> None:
    station = line.accounts.caller(await line.accounts.token_of(line.session))
    assert (station.name, station.person) == ("Station 1", None)
    assert station.grants == (Grant(Role.OPERATOR),)
    owner, path = await line.accounts.owner(), f"/users/{line.subjects['Ben']}/identifiers/qr"
    code = (await line.accounts.call("PUT", path, {"value": "new"}, token=owner)).json()["qr"]
    for method, value, name in (
        ("badge", "B-Anna-1", "Anna"),
        ("qr", code, "Ben"),
        ("pin", PINS["Anna"], "Anna"),
    ):
        assert await line.join(method, value) == 200
        acting = line.accounts.caller(await line.accounts.token_of(line.session))
        assert (acting.name, acting.subject) == (name, station.subject)
        assert acting.person == {"Anna": ANNA, "Ben": BEN}[name]
        assert not acting.may(Permission.CONFIGURE), "joining gives no right"
    assert await line.join("badge", "B-Nobody-1") == 404
    assert await line.there() == "Anna", "who was there remains"
    assert (await line.screen("DELETE", "/me/station/person")).status_code == 204
    assert await line.there() is None
    methods = {(one["subject"], one["method"]) for one in await line.records("station.joined")}
    assert {method for _, method in methods} == {"badge", "qr", "pin"}
    assert {subject for subject, _ in methods} == set(line.subjects.values())


async def test_a_personal_gesture_joins_and_leaves(line: Line) -> None:
    await line.gesture("Anna hello")
    assert await line.there() == "Anna"
    await line.gesture("Thumbs up")
    assert await line.there() == "Anna", "a gesture of nobody has no effect"
    await line.gesture("Ben hello")
    assert await line.there() == "Ben", "the next person takes over"
    joins = (await line.accounts.as_page("GET", "/station-joins")).json()["stations"]
    assert joins[0]["gloves"] == ["glove-1", "glove-2"]
    assert (joins[0]["joined"]["person"], joins[0]["joined"]["method"]) == (BEN, "gesture")
    await line.gesture("Ben hello", "glove-2")
    assert await line.there() is None
    await line.gesture("Ben hello", "glove-of-nobody")
    assert await line.there() is None


async def test_a_person_leaves_by_time_and_the_audit_says_so(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert await line.join("badge", "B-Anna-1") == 200
    assert (await line.screen("POST", "/me/station/seen")).status_code == 204
    store = line.accounts.directory.store
    with store.change("test") as change:
        change.connection.exec_driver_sql("UPDATE accounts_join SET seen_s = seen_s - 3600")
        change.is_recorded = True
    with store.read() as connection:
        assert joined(connection, line.station["subject"]) is None
    async with asyncio.timeout(60):
        while not await line.records("station.left"):
            await asyncio.sleep(0.1)
    left = (await line.records("station.left"))[0]
    assert left["method"] == "time"
    assert line.accounts.caller(await line.accounts.token_of(line.session)).person is None


async def test_one_person_is_at_one_station(line: Line) -> None:
    await line.join("badge", "B-Anna-1")
    engineer = await line.accounts.token_of((await line.accounts.sign_in("Erin")).json()["session"])
    same = {"name": "Station 2", "gloves": ["glove-2"]}
    assert (await line.accounts.call("POST", "/stations", same, token=engineer)).status_code == 409
    other = Line(line.accounts)
    body = {"name": "Station 2", "gloves": ["glove-3"]}
    other.station = (await line.accounts.call("POST", "/stations", body, token=engineer)).json()
    other.session = await other.sign_in()
    await other.join("badge", "B-Anna-1")
    assert await other.there() == "Anna"
    assert await line.there() is None


async def test_pins_are_limited_and_verified_for_tasks(line: Line) -> None:
    async def is_right(person: str, pin: str) -> Any:
        body = {"person": person, "pin": pin, "task": "urn:ngsi-ld:Task:demo:p-1"}
        answer = await line.accounts.as_page("POST", "/pin-checks", body)
        if answer.status_code != 200:
            return answer.status_code
        found = answer.json()
        assert (found["proof"] is not None) is found["isRight"]
        return found["isRight"]

    assert await is_right(ANNA, PINS["Anna"]) is True
    assert await is_right(ANNA, PINS["Ben"]) is False
    guesses = [await is_right(BEN, f"{number:06}") for number in range(30)]
    assert guesses.count(False) < 10
    assert 429 in guesses
    assert await is_right(ANNA, PINS["Anna"]) is True, "another person is not shut out"
    tries = [await line.join("pin", f"{number:06}") for number in range(30)]
    assert 429 in tries


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("kind", "value"), [("pin", "12"), ("pin", "0000"), ("pin", "123456"), ("badge", "a b"), ("pin", "12a4")]
)
async def test_an_identifier_that_is_none_is_refused(line: Line, kind: str, value: str) -> None:
    path = f"/users/{line.subjects['Anna']}/identifiers/{kind}"
    answer = await line.accounts.call("PUT", path, {"value": value}, token=await line.accounts.owner())
    assert answer.status_code == 422


async def test_an_identifier_names_one_person_and_goes_with_them(line: Line) -> None:
    owner = await line.accounts.owner()
    path = f"/users/{line.subjects['Ben']}/identifiers/badge"
    assert (await line.accounts.call("PUT", path, {"value": "B-Anna-1"}, token=owner)).status_code == 409
    await line.join("badge", "B-Anna-1")
    deleted = await line.accounts.call("DELETE", f"/users/{line.subjects['Anna']}", token=owner)
    assert deleted.status_code == 200
    assert await line.there() is None
    assert await line.join("badge", "B-Anna-1") == 404
    assert (await line.accounts.call("PUT", path, {"value": "B-Anna-1"}, token=owner)).status_code == 200


async def test_only_an_engineer_makes_stations_and_gives_no_more_than_they_have(accounts: Accounts) -> None:
    await accounts.owner()
    body = {"name": "Station 1", "gloves": ["glove-1"]}
    for name, grant in (
        ("Olaf", ("operator", "*")),
        ("Emil", ("engineer", "urn:ngsi-ld:Device:demo:ur10-1")),
    ):
        token = await accounts.token_of(await accounts.member(name, grant))
        assert (await accounts.call("POST", "/stations", body, token=token)).status_code == 403
    operator = (await accounts.sign_in("Olaf")).json()["session"]
    answer = await accounts.call(
        "PUT",
        "/me/station/person",
        {"method": "pin", "value": "4802"},
        token=await accounts.token_of(operator),
    )
    assert answer.status_code == 409, "a person's own session is no station"


async def test_a_station_is_signed_out_by_the_pin_of_who_has_joined_or_of_an_engineer_alone(
    line: Line,
) -> None:
    accounts, owner = line.accounts, await line.accounts.owner()
    engineer = accounts.caller(await accounts.token_of(await accounts.member("Frida", ("engineer", "*"))))
    pin = {"value": "592837"}
    path = f"/users/{engineer.subject}/identifiers/pin"
    assert (await accounts.call("PUT", path, pin, token=owner)).is_success

    async def sign_out(pin: str | None) -> int:
        body = {"session": line.session, **({} if pin is None else {"pin": pin})}
        return int((await accounts.as_page("POST", "/sign-out", body)).status_code)

    async def is_signed_in() -> bool:
        body = {"session": line.session}
        return bool((await accounts.as_page("POST", "/session-tokens", body)).status_code == 201)

    was_in = await is_signed_in()
    for refused in (None, "", PINS["Anna"], "000000"):
        assert await sign_out(refused) == 403, "nobody has joined"
    assert await line.join("badge", "B-Anna-1") == 200
    assert await sign_out(PINS["Ben"]) == 403, "Ben is not there"
    assert await line.there() == "Anna"
    own = (await line.screen("GET", "/me/sessions")).json()
    assert (await line.screen("DELETE", f"/me/sessions/{own[0]['id']}")).status_code == 403
    assert (await line.screen("DELETE", "/me/sessions")).status_code == 403
    assert await is_signed_in() == was_in
    assert await sign_out(PINS["Anna"]) == 200
    assert (await accounts.as_page("POST", "/session-tokens", {"session": line.session})).status_code == 401

    line.session = await line.sign_in()
    assert await sign_out(pin["value"]) == 200, "an engineer"
    records = [(one["outcome"], one["method"]) for one in await line.records("station.signedOut")]
    assert records.count(("done", "pin")) == 2
    assert records.count(("refused", "pin")) == 5


async def test_attempts_to_sign_a_station_out_are_limited(line: Line) -> None:
    body = {"session": line.session, "pin": "000000"}
    answers = [(await line.accounts.as_page("POST", "/sign-out", body)).status_code for _ in range(40)]
    assert answers[0] == 403
    assert answers[-1] == 429
    assert await line.there() is None


async def test_people_sign_out_without_a_pin(accounts: Accounts) -> None:
    session = await accounts.member("Mia")
    assert (await accounts.as_page("POST", "/sign-out", {"session": session})).status_code == 200
