"""Parameters of Tasks on a broker that speaks as Orion-LD: what is read is what was written."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from handover.broker import BrokerClient
from handover.settings import Settings
from tests.kit.cell import Cell
from tests.kit.other_broker.running import orion_like

pytestmark = pytest.mark.slow

TASK = "urn:ngsi-ld:Task:demo:free"
VALUES = st.recursive(
    st.booleans() | st.integers(-(2**53), 2**53) | st.text("aä1 ", max_size=4),
    lambda inner: (
        st.lists(inner, max_size=2) | st.dictionaries(st.text("abc", min_size=1), inner, max_size=2)
    ),
    max_leaves=6,
)


@pytest.fixture
def orion(shared_cell: Cell, tmp_path: Path) -> Iterator[Settings]:
    shared_cell.run("context_broker")
    context = f"{shared_cell.url('context_broker')}/context.jsonld"
    with orion_like(shared_cell.environment, tmp_path) as url:
        yield Settings.load(broker_url=url, context_url=context)


@pytest.mark.nightly
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.dictionaries(st.text("abc", min_size=1), VALUES, max_size=3), VALUES)
@example({"at": 1764408000000, "steps": [1], "nested": {"list": [[2147483648]]}}, [7])
def test_parameters_and_outputs_are_read_as_they_were_written(
    orion: Settings, parameters: dict[str, Any], output: Any
) -> None:
    async def round_trip() -> None:
        async with BrokerClient(orion) as broker:
            task = {
                "id": TASK,
                "type": "Task",
                "workParameters": {"type": "Property", "value": parameters},
                "outputParameters": {"type": "Property", "value": {}},
            }
            await broker.upsert([task])
            outputs = {"type": "Property", "value": {"result": output}}
            await broker.append(TASK, {"outputParameters": outputs})
            read = await broker.retrieve(TASK)
            (queried,) = await broker.query(type="Task", id=TASK)
            for one in (read, queried):
                assert one["workParameters"]["value"] == parameters
                assert one["outputParameters"] == outputs

    asyncio.run(round_trip())
