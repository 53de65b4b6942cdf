"""The real application of human state in this process, with a real broker."""

import os
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from services.human_state.app import make_app
from services.human_state.settings import HumanStateSettings
from tests.kit.cell import Cell

# liblsl reads its settings when it is loaded: streams stay on this machine.
os.environ.setdefault("LSLAPICFG", str(Path(__file__).parents[2] / "kit" / "lsl.cfg"))

PURPOSES = ["live", "speedLimits", "history", "broker"]
HEART_RATE = {"signals": ["heartRate"], "packet_s": 0.1}
Running = Callable[..., AbstractAsyncContextManager[httpx.AsyncClient]]


def consent(*purposes: str, hours: float = 1) -> dict[str, Any]:
    return {
        "purposes": purposes or PURPOSES,
        "ends": (datetime.now(UTC) + timedelta(hours=hours)).isoformat(),
        "givenBy": "Aino",
    }


@pytest.fixture
def running(shared_cell: Cell, tmp_path: Path) -> Running:
    """Run the application; a second time with the same database."""
    shared_cell.run("context_broker")

    @asynccontextmanager
    async def run(**members: Any) -> AsyncIterator[httpx.AsyncClient]:
        settings = HumanStateSettings.load(
            **{
                "broker_url": shared_cell.url("context_broker"),
                "broker_tenant": shared_cell.tenant or None,
                "trajectory_port": shared_cell.ports["trajectory_tool"],
                "data_dir": tmp_path,
                **members,
            }
        )
        app = make_app(settings)
        transport = httpx.ASGITransport(app, client=("127.0.0.1", 1))
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as rest,
        ):
            yield rest

    return run


async def add_person(rest: httpx.AsyncClient, name: str = "aino", *purposes: str) -> dict[str, Any]:
    """Add a person of 40 years who consents, with a simulated strap."""
    (await rest.put(f"/people/{name}", json={"age": 40})).raise_for_status()
    (await rest.put(f"/people/{name}/consent", json=consent(*purposes))).raise_for_status()
    sensor = {"person": name, "driver": "simulated", "settings": HEART_RATE}
    made: dict[str, Any] = (await rest.put(f"/sensors/strap-{name}", json=sensor)).raise_for_status().json()
    return made
