"""A real broker and a real gateway as processes; devices are TCP clients."""

import json
import socket
import ssl
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import ExitStack, asynccontextmanager
from pathlib import Path
from typing import Any, Self

import httpx
import pytest
from pydantic import TypeAdapter

from handover_broker.app import create_broker
from handover_broker.settings import BrokerSettings
from handover_devices.routes.views import CommandView
from tests.kit.cell import Cell
from tests.kit.waiting import scaled

SENSOR = {
    "kind": "sensor",
    "sensors": [
        {"name": "temperature", "unit": "CEL", "minimum": -20, "maximum": 60},
        {"name": "isOpen"},
    ],
    "commands": [
        {"name": "setInterval", "kind": "setting"},
        {"name": "beep", "kind": "action"},
        {
            "name": "turn",
            "kind": "motion",
            "parameters": {"type": "object", "required": ["rad"], "properties": {"rad": {"type": "number"}}},
        },
    ],
}


class TcpDevice:
    """A device as a TCP client, or one with TLS."""

    def __init__(
        self,
        port: int,
        name: str,
        token: str,
        boot: str = "b1",
        tls: ssl.SSLContext | None = None,
        **hello: Any,
    ) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=scaled(30))
        if tls is not None:
            self.socket = tls.wrap_socket(self.socket, server_hostname="127.0.0.1")
        self.lines = self.socket.makefile("rb")
        self.say(type="hello", version=1, device=name, token=token, boot=boot, **hello)
        self.greeting = self.receive()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.lines.close()
        self.socket.close()

    def say(self, **message: Any) -> None:
        """Send a message."""
        self.socket.sendall(json.dumps(message).encode() + b"\n")

    def receive(self) -> dict[str, Any] | None:
        """Return the next message; None at the end of the connection."""
        line = self.lines.readline()
        message: dict[str, Any] | None = json.loads(line) if line else None
        return message

    def ask(self, **message: Any) -> dict[str, Any] | None:
        """Send a message and return the next one."""
        self.say(**message)
        return self.receive()


class Bench:
    """A client of the gateway's REST interface, and the devices that connect to it."""

    def __init__(self, cell: Cell, stack: ExitStack) -> None:
        self.cell = cell
        self.rest = stack.enter_context(
            httpx.Client(base_url=cell.url("device_gateway"), timeout=120, trust_env=False)
        )
        self._stack = stack

    def add(self, name: str, **description: Any) -> str:
        """Register a device and return its token."""
        body = {"name": name, "description": {**SENSOR, **description}}
        token: str = self.rest.post("/devices", json=body).raise_for_status().json()["token"]
        return token

    def connect(self, name: str, token: str, boot: str = "b1") -> TcpDevice:
        """Connect a device."""
        return self._stack.enter_context(TcpDevice(self.cell.ports["devices"], name, token, boot))

    def order(self, device: str, name: str, **members: Any) -> httpx.Response:
        """Command a device."""
        answer = self.rest.post(f"/devices/{device}/commands", json={"name": name, **members})
        if answer.is_success:
            TypeAdapter(CommandView).validate_python(answer.json(), extra="forbid")  # as it is documented
        return answer

    def command(self, device: str, identifier: str, wait_s: float = 0) -> dict[str, Any]:
        """Return a command."""
        answer = self.rest.get(f"/devices/{device}/commands/{identifier}", params={"wait": wait_s})
        found: dict[str, Any] = answer.raise_for_status().json()
        return found


@pytest.fixture
def new_bench(shared_cell: Cell) -> Iterator[Callable[[], Bench]]:
    """Make a client of the running gateway; another one after it was restarted."""
    shared_cell.extra["HANDOVER_DEVICE_REPORT_INTERVAL_S"] = "0.2"
    shared_cell.run("context_broker", "device_gateway")
    with ExitStack() as stack:
        yield lambda: Bench(shared_cell, stack)


@pytest.fixture
def bench(new_bench: Callable[[], Bench]) -> Bench:
    """A client of the running gateway."""
    return new_bench()


@asynccontextmanager
async def broker_in_process(folder: Path) -> AsyncIterator[Any]:
    """Run a real broker as an ASGI application, without a port."""
    broker: Any = create_broker(BrokerSettings(data_dir=folder, _env_file=None))
    await broker._serve()
    try:
        yield broker
    finally:
        await broker._broker.stop()


def now_s() -> float:
    """Return the time since 1970."""
    return time.time()
