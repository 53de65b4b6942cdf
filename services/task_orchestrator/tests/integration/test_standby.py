"""Two orchestrators on one PostgreSQL database: one works, the other takes over."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import httpx
import pytest
from sqlalchemy import create_engine, text

from services.task_orchestrator.tests.integration.cell import Member, cell, eventually
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, path, start
from tests.kit.ports import next_free_port

pytestmark = pytest.mark.slow

STEPS = start() + activity("first") + activity("second") + end() + path("start", "first", "second", "end")


@pytest.mark.nightly
def test_a_standby_takes_over_and_nothing_is_lost_or_doubled(
    tmp_path: Path, new_database: Callable[[], str]
) -> None:
    database = new_database()
    port = next_free_port()
    url = f"http://127.0.0.1:{port}"
    with cell(tmp_path, next_free_port, database, standby_urls=[url]) as running:
        standby = Member(
            "standby",
            "handover_processes",
            {**running.orchestrator.environment, "HANDOVER_ORCHESTRATOR_PORT": str(port)},
            tmp_path / "standby.log",
            f"{url}/healthz",
        )
        xml, headers = drawing(STEPS), {"Content-Type": "application/xml"}
        running.api.post("/definitions", content=xml, headers=headers).raise_for_status()
        processes = [running.start("p") for _ in range(20)]
        try:
            standby.launch()
            eventually(lambda: "standby" in standby.log(), "the second orchestrator waiting")
            assert running.api.get("/healthz").is_success
            with pytest.raises(httpx.ConnectError):
                httpx.get(f"{url}/healthz", trust_env=False)
            running.orchestrator.kill()
            running.api.close()
            running.api = httpx.Client(base_url=url, trust_env=False, timeout=120)
            standby.wait()
            for process in processes:
                assert running.ended(process)["status"] == "completed"
            done = running.done()
            assert len(done) == len(set(done)) == 40
        finally:
            standby.stop()


@pytest.mark.nightly
def test_one_that_has_lost_its_lock_ends_instead_of_writing(
    tmp_path: Path, new_database: Callable[[], str]
) -> None:
    database = new_database()
    with cell(tmp_path, next_free_port, database) as running:
        engine = create_engine(database.replace("postgresql://", "postgresql+psycopg://"))
        with engine.connect() as other:
            xml, headers = drawing(STEPS), {"Content-Type": "application/xml"}
            running.api.post("/definitions", content=xml, headers=headers).raise_for_status()
            other.execute(text("SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory'"))
            lock = text("SELECT pg_try_advisory_lock(hashtext('handover task orchestrator'))")
            eventually(lambda: other.execute(lock).scalar(), "the lock")
            for _ in range(2):  # the first one finds out that the connection has gone
                with suppress(httpx.TransportError):  # it may have ended already
                    answer = running.api.post("/processes", json={"definition": "p"})
                    assert answer.status_code == 503
            eventually(lambda: "another orchestrator has taken over" in running.orchestrator.log(), "its end")
        engine.dispose()
