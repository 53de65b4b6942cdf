"""A database that cannot be used now is 503; a statement that is wrong stays a fault of ours."""

import sqlite3
from pathlib import Path

import httpx
import pytest
from sqlalchemy import Engine, create_engine, text
from sqlalchemy.exc import SQLAlchemyError

from handover.database.outage import in_database, outage_problem
from handover.errors import Problem
from handover.serving.service import create_app


@pytest.fixture
def engine(tmp_path: Path) -> Engine:
    engine = create_engine(f"sqlite:///{tmp_path / 'lamp.sqlite'}", connect_args={"timeout": 0})
    with engine.begin() as connection:
        connection.execute(text("CREATE TABLE lamp (name TEXT NOT NULL)"))
    return engine


def fault_of(engine: Engine, *statements: str) -> SQLAlchemyError:
    def run() -> None:
        with engine.begin() as connection:
            for statement in statements:
                connection.execute(text(statement))

    with pytest.raises(SQLAlchemyError) as caught:
        run()
    return caught.value


def test_a_full_or_locked_database_is_an_outage(engine: Engine, tmp_path: Path) -> None:
    full = fault_of(engine, "PRAGMA max_page_count = 2", "INSERT INTO lamp VALUES (zeroblob(100000))")
    problem = outage_problem(full)
    assert problem is not None
    assert (problem.status, problem.extra) == (503, {"retryAfterS": 2})
    assert problem.detail.startswith("nothing was changed: ")
    other = sqlite3.connect(tmp_path / "lamp.sqlite", isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    assert outage_problem(fault_of(engine, "INSERT INTO lamp VALUES ('a')")) is not None


@pytest.mark.parametrize(
    "statement", ["SELECT * FROM torch", "SELECT FROM WHERE", "INSERT INTO lamp VALUES (NULL)"]
)
def test_a_wrong_statement_is_none(engine: Engine, statement: str) -> None:
    assert outage_problem(fault_of(engine, statement)) is None


@pytest.mark.nightly
async def test_every_route_of_a_service_answers_so(engine: Engine) -> None:
    app = create_app("lamp", description="A lamp.")

    @app.get("/read")
    def read(statement: str) -> None:
        with engine.begin() as connection:
            connection.execute(text(statement))

    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://lamp") as http:
        assert (await http.get("/read", params={"statement": "SELECT * FROM torch"})).status_code == 500
        with sqlite3.connect(str(engine.url.database), isolation_level=None) as other:
            other.execute("BEGIN EXCLUSIVE")
            answer = await http.get("/read", params={"statement": "INSERT INTO lamp VALUES ('a')"})
            other.execute("ROLLBACK")
    assert (answer.status_code, answer.headers["Retry-After"]) == (503, "2")
    assert answer.json()["detailCode"] == "service.database_unavailable"


async def test_other_errors_of_a_function_are_its_own(engine: Engine) -> None:
    error = fault_of(engine, "SELECT FROM WHERE")

    def fails(raised: Exception) -> None:
        raise raised

    with pytest.raises(SQLAlchemyError):
        await in_database(fails, error)
    with pytest.raises(Problem):
        await in_database(fails, Problem(409, "Lit already", "switch it off first"))
