"""The real application of human state in this process, with a real broker."""

import os
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.security.access_tokens import SigningKey, key_set
from handover.security.caller import Caller, CallerKind
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.permissions import Grant
from handover_body.app import make_app
from handover_body.settings import HumanStateSettings
from tests.integration.cell.test_rights_of_callers import Uninterrupted
from tests.kit.asgi_server import served
from tests.kit.cell import Cell
from tests.kit.paths import REPOSITORY

# liblsl reads its settings when it is loaded: streams stay on this machine.
os.environ.setdefault("LSLAPICFG", str(REPOSITORY / "tests" / "kit" / "lsl.cfg"))

KEY = SigningKey.generate()
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
    """Run the application; a second time with the same database.

    With `grants` there are accounts, and the client is a user with them; with `port` a server answers.
    """
    shared_cell.run("context_broker")

    @asynccontextmanager
    async def run(
        *, grants: Sequence[Grant] | None = None, port: int | None = None, **members: Any
    ) -> AsyncIterator[httpx.AsyncClient]:
        settings = HumanStateSettings.load(
            **{
                "broker_url": shared_cell.url("context_broker"),
                "broker_tenant": shared_cell.tenant or None,
                "trajectory_port": shared_cell.ports["trajectory_tool"],
                "data_dir": tmp_path,
                "health_on_other_broker": True,
                **members,
            }
        )
        if grants is not None:
            settings.security_folder.mkdir(exist_ok=True)
            (settings.security_folder / PUBLIC_KEYS_FILE).write_bytes(key_set(KEY))
        app = make_app(settings)
        if grants is not None:
            app.state.guard._revocations = Uninterrupted()
        if port is None:
            transport = httpx.ASGITransport(app, client=("127.0.0.1", 1))
            url, answering = "http://127.0.0.1", app.router.lifespan_context(app)
        else:
            transport, url, answering = None, f"http://127.0.0.1:{port}", served(app, port)
        headers = {} if grants is None else {"Authorization": f"Bearer {token_of(*grants)}"}
        async with (
            answering,
            httpx.AsyncClient(
                transport=transport, base_url=url, headers=headers, timeout=60, trust_env=False
            ) as rest,
        ):
            yield rest

    return run


def token_of(*grants: Grant) -> str:
    return KEY.issue(Caller(CallerKind.USER, "subject-1", "Olga", grants), valid_s=3600)


async def add_person(rest: httpx.AsyncClient, name: str = "aino", *purposes: str) -> dict[str, Any]:
    """Add a person of 40 years who consents, with a simulated strap."""
    (await rest.put(f"/people/{name}", json={"age": 40})).raise_for_status()
    (await rest.put(f"/people/{name}/consent", json=consent(*purposes))).raise_for_status()
    sensor = {"person": name, "driver": "simulated", "settings": HEART_RATE}
    made: dict[str, Any] = (await rest.put(f"/sensors/strap-{name}", json=sensor)).raise_for_status().json()
    return made
