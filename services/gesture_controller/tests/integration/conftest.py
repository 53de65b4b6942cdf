"""A real broker and a real controller as processes; the glove is a TCP client with a clock of its own."""

from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import ExitStack
from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient
from handover_datamodels.entities import Task
from tests.kit.cell import Cell
from tests.kit.gloves import TcpGlove

GLOVE = "urn:ngsi-ld:Device:demo:glove-1"


class Bench:
    """What a test does at the workplace: put Tasks, look at the screen, press its buttons."""

    def __init__(self, cell: Any, broker: BrokerClient) -> None:
        self.cell = cell
        self.broker = broker
        self.screen = httpx.Client(base_url=cell.url("gesture_controller"), timeout=120, trust_env=False)

    async def put(
        self, name: str, resource: str = GLOVE, involves: Sequence[str] = (), **parameters: Any
    ) -> str:
        """Put a pending Task for `resource`, or one that `involves` several, and return its id."""
        links = [{"type": "Relationship", "object": one} for one in involves or [resource]]
        task_id = f"urn:ngsi-ld:Task:demo:{name}"
        await self.broker.create(
            {
                "id": task_id,
                "type": "Task",
                "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:confirm"},
                "status": {"type": "Property", "value": "pending", "observedAt": "2026-01-01T12:00:00Z"},
                "involves": {"type": "Property", "value": links},
                "workParameters": {"type": "Property", "value": parameters},
            }
        )
        return task_id

    async def status(self, task_id: str) -> str:
        """Return the status of a Task as the broker has it."""
        return str((await self.broker.get(task_id, Task)).status.value)

    async def outputs(self, task_id: str) -> dict[str, Any]:
        """Return the outputParameters of a Task."""
        given = (await self.broker.get(task_id, Task)).output_parameters
        return dict(given.value) if given is not None else {}

    async def device(self, glove: str = GLOVE) -> dict[str, Any]:
        """Return the values of a Device entity."""
        entity = await self.broker.retrieve(glove)
        return {name: one.get("value") for name, one in entity.items() if isinstance(one, dict)}

    async def alerts(self) -> list[dict[str, Any]]:
        """Return all Alerts."""
        return await self.broker.query(type="Alert")

    def view(self, glove: str = "glove-1") -> dict[str, Any]:
        """Return what the screen shows of a glove."""
        view: dict[str, Any] = self.screen.get(f"/gloves/{glove}").raise_for_status().json()
        return view

    def press(self, act: str, glove: str = "glove-1", **body: Any) -> httpx.Response:
        """Press a button of the screen."""
        return self.screen.post(f"/gloves/{glove}/{act}", json=body or None)


@pytest.fixture
def silence_s() -> float:
    """After how long a glove is taken for lost: long, so that a glove may wait for the test."""
    return 60.0


@pytest.fixture
def running_cell(tenant_cell: Cell, silence_s: float) -> Cell:
    """A cell in which broker and controller run."""
    tenant_cell.extra["HANDOVER_SILENCE_S"] = str(silence_s)
    tenant_cell.run("context_broker", "gesture_controller")
    return tenant_cell


@pytest.fixture
async def bench(running_cell: Cell) -> AsyncIterator[Bench]:
    """The workplace."""
    async with BrokerClient(running_cell.settings) as broker:
        made = Bench(running_cell, broker)
        try:
            yield made
        finally:
            made.screen.close()


@pytest.fixture
def put_on(running_cell: Any) -> Iterator[Callable[..., TcpGlove]]:
    """Put on a glove."""
    with ExitStack() as stack:

        def wear(name: str = "glove-1", hand: str = "right", token: str = "") -> TcpGlove:
            glove = TcpGlove(running_cell.ports["glove"], name, hand, token)
            stack.callback(glove.close)
            return glove

        yield wear
