"""Of replicas on one PostgreSQL database one leads; another one takes over, and the first writes no more."""

from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import httpx
import pytest
from sqlalchemy import Engine, create_engine, text

from handover.database import LockLost, connect
from handover.serving.leadership import Leadership
from handover_alerts.app import make_app
from handover_alerts.settings import RouterSettings
from tests.kit.ports import next_free_port
from tests.kit.waiting import until


class Replica:
    """A replica that counts how often its work was begun, and whether it lasts."""

    def __init__(self, url: str, service: str = "lamp") -> None:
        self.engine: Engine = connect(url)
        self.leadership = Leadership(self.engine, service)
        self.begun = 0
        self.works = False

    @asynccontextmanager
    async def work(self) -> AsyncIterator[None]:
        self.begun += 1
        self.works = True
        try:
            yield
        finally:
            self.works = False


@pytest.fixture
async def pair(new_database: Callable[[], str]) -> AsyncIterator[tuple[Replica, Replica, str]]:
    url = new_database()
    first, second = Replica(url), Replica(url)
    async with AsyncExitStack() as stack:
        for one in (first, second):
            await stack.enter_async_context(one.leadership.led(one.work))
        yield first, second, url
    first.engine.dispose()
    second.engine.dispose()


async def test_the_replica_that_waits_takes_over_when_the_leader_has_lost_its_connection(
    pair: tuple[Replica, Replica, str],
) -> None:
    first, second, url = pair
    assert (first.works, second.works) == (True, False)
    await first.leadership.check()
    with pytest.raises(ConnectionError, match="another lamp leads"):
        await second.leadership.check()
    with pytest.raises(LockLost), second.leadership.transaction():
        pass
    server = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))
    with server.connect() as other:
        other.execute(text("SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory'"))
    server.dispose()
    await until(lambda: first.works != second.works and first.begun + second.begun == 2)
    leader, follower = (first, second) if first.works else (second, first)
    with leader.leadership.transaction() as connection:
        connection.execute(text("CREATE TABLE lamp (id int)"))
    with pytest.raises(LockLost), follower.leadership.transaction():
        pass


async def test_a_leader_that_ends_hands_over(new_database: Callable[[], str]) -> None:
    url = new_database()
    first, second = Replica(url), Replica(url)
    async with AsyncExitStack() as stack:
        async with first.leadership.led(first.work):
            await stack.enter_async_context(second.leadership.led(second.work))
            assert not second.works
        assert not first.works
        await until(lambda: second.works)
    assert not second.works
    first.engine.dispose()
    second.engine.dispose()


async def test_on_sqlite_the_only_process_leads(tmp_path: Path) -> None:
    only = Replica(f"sqlite:///{tmp_path / 'lamp.db'}")
    async with only.leadership.led(only.work):
        await only.leadership.check()
        with only.leadership.transaction() as connection:
            connection.execute(text("CREATE TABLE lamp (id int)"))
    assert (only.begun, only.works) == (1, False)
    only.engine.dispose()


async def test_work_that_cannot_begin_stops_the_start(tmp_path: Path) -> None:
    only = Replica(f"sqlite:///{tmp_path / 'lamp.db'}")

    @asynccontextmanager
    async def broken() -> AsyncIterator[None]:
        raise ValueError("the lamp is broken")
        yield

    with pytest.raises(ValueError, match="broken"):
        async with only.leadership.led(broken):
            pass
    only.engine.dispose()


async def test_a_second_alert_router_answers_as_a_standby_until_the_first_ends(
    new_database: Callable[[], str], tmp_path: Path
) -> None:
    url = new_database()
    route = {"channels": ["ops"]}
    channel = {"type": "mail", "to": ["ops@example.org"]}
    async with AsyncExitStack() as stack:
        clients = []
        contexts = []
        for name in ("a", "b"):
            settings = RouterSettings(
                data_dir=tmp_path / name,
                database_url=url,
                broker_url=f"http://127.0.0.1:{next_free_port()}",
                _env_file=None,
            )
            app = make_app(settings)
            contexts.append(app.router.lifespan_context(app))
            await contexts[-1].__aenter__()
            transport = httpx.ASGITransport(app, client=("127.0.0.1", 1))
            client = httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60)
            clients.append(await stack.enter_async_context(client))
        leader, standby = clients
        (await leader.put("/channels/ops", json=channel)).raise_for_status()
        (await leader.put("/routes/all", json=route)).raise_for_status()
        refused = await standby.get("/routes")
        assert (refused.status_code, refused.json()["title"]) == (503, "Standby")
        assert (await standby.get("/healthz")).status_code == 200
        assert "another alert-router leads" in (await standby.get("/readyz")).json()["leadership"]
        await contexts[0].__aexit__(None, None, None)

        async def answers() -> bool:
            return (await standby.get("/routes")).status_code == 200

        await until(answers)
        assert "all" in (await standby.get("/routes")).text, "what the first leader has stored"
        await contexts[1].__aexit__(None, None, None)
