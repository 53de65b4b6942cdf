"""The audit trail: changes with their transaction, private reads once, refusals, and nothing of services."""

from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from sqlalchemy import Column, Engine, MetaData, String, Table, insert, select
from typer.testing import CliRunner

from handover.command_line.main import app as command_line
from handover.database import connect
from handover.database.migrations import migrate
from handover.errors import Problem
from handover.security.act_recording import lowers, recorded_with_change
from handover.security.audit import INTENDED, AuditLog, AuditTables
from handover.security.audit_reading import audit_chains
from handover.security.audit_trail import AuditEntry, AuditTrail, record_deletion, record_request
from handover.security.caller import Caller, CallerKind
from handover.security.guard import Guard, in_path, require
from handover.security.permissions import Grant, Permission, Role
from handover.security.revocations import FollowedRevocations
from handover.serving.service import create_app
from handover.settings import Settings
from tests.kit.bearer_tokens import KEY, UR10, bearer, set_up_accounts
from tests.kit.waiting import until

ANNA = "urn:ngsi-ld:Person:demo:anna"
ALL = (Grant(Role.ENGINEER), Grant(Role.RESEARCHER), Grant(Role.ADMIN))
CALLER = Caller(CallerKind.USER, "s1", "Rosa")
LAMPS = Table("lamp", MetaData(), Column("name", String(20), primary_key=True))


class CurrentRevocations(FollowedRevocations):
    """Revocations that stay current on the slowest machine."""

    def is_current(self) -> bool:
        return True


class Lamp:
    """An application with a database, whose routes change and read as ours do."""

    def __init__(self, folder: Path) -> None:
        self.jogs = 0
        self.during: Callable[[], None] = lambda: None
        """What happens while the robot is jogged."""
        settings = Settings(data_dir=folder, _env_file=None)
        self.engine: Engine = connect(settings.database("lamp"))
        LAMPS.metadata.create_all(self.engine)
        revocations = CurrentRevocations()
        guard = Guard(settings, "lamp", revocations=revocations)
        self.trail = AuditTrail(settings, "lamp", self.engine)
        self.app = create_app("lamp", description="A lamp.", guard=guard, audit=self.trail)
        self._add_routes(self.app)

    def _add_routes(self, app: FastAPI) -> None:
        @app.put("/lamps/{lamp}", dependencies=[require(Permission.CONFIGURE)])
        @recorded_with_change
        def keep(lamp: str, fails: bool = False) -> None:
            with self.engine.begin() as connection:
                connection.execute(insert(LAMPS).values(name=lamp))
                record_request(connection)
                if fails:
                    raise Problem(503, "Storage unavailable", "the disk is full")

        @app.post(
            "/robots/{robot}/jog", dependencies=[require(Permission.MOVE_ROBOTS, in_path("Device", "robot"))]
        )
        async def jog(robot: str) -> str:
            self.jogs += 1
            self.during()
            return robot

        @app.post(
            "/robots/{robot}/stop",
            status_code=204,
            dependencies=[require(Permission.MOVE_ROBOTS, in_path("Device", "robot"))],
        )
        @lowers()
        async def stop(robot: str) -> None: ...

        @app.delete(
            "/people/{person}", dependencies=[require(Permission.MANAGE_PEOPLE, in_path("Person", "person"))]
        )
        @recorded_with_change
        def remove(person: str) -> None:
            with self.engine.begin() as connection:
                record_deletion(connection)

        @app.put(
            "/people/{person}", dependencies=[require(Permission.CONFIGURE, in_path("Person", "person"))]
        )
        async def change(person: str) -> None: ...

        @app.get("/pulse", dependencies=[require(Permission.READ_HEALTH_DATA)])
        async def pulse() -> int:
            return 60

        @app.get("/state", dependencies=[require(Permission.READ)])
        async def state() -> str:
            return "on"

    def deny(self, name: str | None) -> None:
        """Let the database refuse every record from now on, or accept them again."""
        with self.engine.begin() as connection:
            if name is None:
                connection.exec_driver_sql("DROP TRIGGER full")
            else:
                connection.exec_driver_sql(
                    "CREATE TRIGGER full BEFORE INSERT ON lamp_audit "
                    f"BEGIN SELECT RAISE(ABORT, '{name}'); END"
                )

    def lamps(self) -> list[str]:
        with self.engine.connect() as connection:
            return list(connection.execute(select(LAMPS.c.name)).scalars())


@pytest.fixture
def lamp(tmp_path: Path) -> Lamp:
    set_up_accounts(tmp_path)
    return Lamp(tmp_path)


@pytest.fixture
async def http(lamp: Lamp) -> AsyncIterator[httpx.AsyncClient]:
    transport = httpx.ASGITransport(lamp.app, raise_app_exceptions=False)
    async with (
        lamp.trail,
        httpx.AsyncClient(transport=transport, base_url="http://localhost", headers=bearer(*ALL)) as client,
    ):
        yield client


async def records(http: httpx.AsyncClient, **chosen: Any) -> list[tuple[str, str, str, str]]:
    answer = await http.get("/audit", params=chosen)
    assert answer.status_code == 200, answer.text
    fields = ("subject", "action", "resource", "outcome")
    return [tuple(one[name] for name in fields) for one in reversed(answer.json())]  # type: ignore[misc]


async def test_a_change_and_its_record_are_committed_together_or_not_at_all(
    http: httpx.AsyncClient, lamp: Lamp
) -> None:
    assert (await http.put("/lamps/one")).status_code == 200
    assert (await http.put("/lamps/two?fails=true")).status_code == 503
    assert lamp.lamps() == ["one"]
    put = ("subject-1", "PUT /lamps/{lamp}", "*")
    assert await records(http) == [(*put, "done"), (*put, "failed")]
    assert (await http.get("/audit/verification")).json()["fault"] is None


async def test_who_moved_which_robot_is_recorded_also_if_it_was_refused(http: httpx.AsyncClient) -> None:
    assert (await http.post("/robots/ur10-1/jog")).status_code == 200
    other = bearer(Grant(Role.ENGINEER, UR10), subject="subject-2")
    assert (await http.post("/robots/nao-1/jog", headers=other)).status_code == 403
    action, nao = "POST /robots/{robot}/jog", "urn:ngsi-ld:Device:demo:nao-1"
    expected = [("subject-1", action, UR10, "done"), ("subject-2", action, nao, "refused")]
    assert await records(http) == expected
    assert await records(http, resource="ur10") == expected[:1]
    assert await records(http, outcome="refused") == expected[1:]
    assert await records(http, subject="subject-2", action="jog") == expected[1:]
    assert await records(http, until=1) == []


async def test_reading_health_data_is_recorded_once_while_a_page_asks_again(
    http: httpx.AsyncClient,
) -> None:
    for _ in range(3):
        assert (await http.get("/pulse")).status_code == 200
        assert (await http.get("/state")).status_code == 200
    assert await records(http) == [("subject-1", "GET /pulse", "*", "done")]


async def test_services_act_for_people_and_are_not_recorded(http: httpx.AsyncClient) -> None:
    caller = Caller(CallerKind.SERVICE, "service-1", "webui", (Grant(Role.SERVICE),))
    token = {"Authorization": f"Bearer {KEY.issue(caller, valid_s=60)}"}
    assert (await http.post("/robots/ur10-1/jog", headers=token)).status_code == 200
    assert await records(http) == []


async def test_a_deleted_person_is_named_nowhere_and_the_chain_is_intact(
    http: httpx.AsyncClient, tmp_path: Path
) -> None:
    await http.put("/people/anna")
    assert (await records(http))[0][2] == ANNA, "known while the person exists"
    assert len(await records(http, resource="anna")) == 1
    await http.delete("/people/anna")
    found = await records(http)
    assert len({resource for _, _, resource, _ in found}) == 1
    answer = await http.get("/audit")
    assert "anna" not in answer.text
    assert (await http.get("/audit/verification")).json() == {
        "records": 3, "head": answer.json()[0]["hash"], "fault": None, "withoutOutcome": [],
    }  # fmt: skip


async def test_a_request_that_cannot_be_recorded_is_refused(http: httpx.AsyncClient, lamp: Lamp) -> None:
    with lamp.engine.begin() as connection:
        connection.exec_driver_sql("DROP TABLE lamp_audit")
    refused = await http.post("/robots/ur10-1/jog")
    assert (refused.status_code, refused.json()["title"]) == (503, "Not recorded")


async def test_all_logs_of_a_folder_are_verified_and_exported(
    http: httpx.AsyncClient, lamp: Lamp, tmp_path: Path
) -> None:
    await http.put("/lamps/one")
    run = CliRunner()
    where = ["--data-dir", str(tmp_path)]
    verified = run.invoke(command_line, ["audit", "verify", *where])
    assert verified.exit_code == 0, verified.output
    assert "lamp: 1 records are intact" in verified.output
    exported = run.invoke(command_line, ["audit", "export", *where])
    assert "PUT /lamps/{lamp}" in exported.output
    with lamp.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE lamp_audit SET subject = 'somebody else'")
    damaged = run.invoke(command_line, ["audit", "verify", *where])
    assert (damaged.exit_code, "record 1 was changed" in damaged.output) == (1, True)
    assert audit_chains.chains_of(Settings(data_dir=tmp_path / "nothing", _env_file=None)) == []


@pytest.mark.parametrize("has_names", [False, True])
async def test_a_trail_of_an_earlier_version_gets_intents_and_its_chain_stays_intact(
    tmp_path: Path, has_names: bool
) -> None:
    settings = Settings(data_dir=tmp_path, _env_file=None)
    engine = connect(settings.database("lamp"))
    before = MetaData()
    tables = AuditTables(before, "lamp", has_aliases=True, has_names=has_names)
    migrate(engine, before, component="lamp_audit", version=2 if has_names else 1)
    with engine.begin() as connection:
        AuditLog(tables).append(connection, "s1", "PUT /lamps/{lamp}", resource="*", text="/lamps/one")
    (chain,) = audit_chains.chains_of(settings)
    assert [view["intent"] for view in audit_chains.records_of([chain])] == [None], "read without a change"
    async with AuditTrail(settings, "lamp", engine, has_names=has_names) as trail:
        (intent,) = await trail.store([AuditEntry(CALLER, "POST /x", "*", INTENDED, "/x")])
        assert await trail.read(trail.log.open_intents) == [intent]
        await trail.store([AuditEntry(CALLER, "POST /x", "*", "done", "/x", intent=intent)])
        assert await trail.read(trail.log.open_intents) == []
        verified = await trail.read(trail.log.verify)
        assert (verified.records, verified.fault) == (3, None)
    engine.dispose()


async def test_an_outcome_that_is_moved_to_another_intent_breaks_the_chain(
    http: httpx.AsyncClient, lamp: Lamp
) -> None:
    for _ in range(2):
        assert (await http.post("/robots/ur10-1/jog")).status_code == 200
    with lamp.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE lamp_audit SET intent = 1 WHERE seq = 4")
    assert (await http.get("/audit/verification")).json()["fault"] == "record 4 was changed"


async def test_an_outcome_that_cannot_be_written_changes_no_answer_and_is_written_later(
    http: httpx.AsyncClient, lamp: Lamp
) -> None:
    lamp.during = lambda: lamp.deny("DENIED")
    assert (await http.post("/robots/ur10-1/jog")).status_code == 200, "it has moved"
    refused = await http.post("/robots/ur10-1/jog")
    assert (refused.status_code, refused.json()["title"], lamp.jogs) == (503, "Not recorded", 1)
    stopped = await http.post("/robots/ur10-1/stop")
    assert (stopped.status_code, stopped.json()) == (200, {"recorded": False})
    lamp.deny(None)

    async def are_written() -> bool:
        jog, stop = "POST /robots/{robot}/jog", "POST /robots/{robot}/stop"
        found = [(action, outcome) for _, action, _, outcome in await records(http)]
        return found == [(jog, "done"), (jog, "failed"), (stop, "done")]

    await until(are_written, why="the records are never written")
    assert (await http.post("/robots/ur10-1/stop")).status_code == 204, "it is recorded at once now"
    assert (await http.get("/audit/verification")).json()["withoutOutcome"] == []


async def test_a_trail_of_an_earlier_version_gets_the_names_of_callers(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, _env_file=None)
    engine = connect(settings.database("lamp"))
    async with AuditTrail(settings, "lamp", engine) as before:
        await before.store([AuditEntry(CALLER, "GET /pulse", ANNA, "done", "/pulse")])
    async with AuditTrail(settings, "lamp", engine, has_names=True) as trail:
        assert await trail.read(lambda connection: trail.log.names(connection, ["s1"])) == {}
        await trail.store([AuditEntry(CALLER, "GET /pulse", ANNA, "done", "/pulse")])
        assert await trail.read(lambda connection: trail.log.names(connection, ["s1"])) == {"s1": "Rosa"}
    engine.dispose()
