"""Definitions are retrieved from a genuine node, which does not use our adapters."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from handover_ros.errors import GraphError, UnknownType
from handover_ros.graph.joining import Adapter, JoinSettings, installed, join
from handover_ros.inspection import definition_retrieval
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.integration.graph.conftest import running_script
from tests.kit.skipping import NO_ROS
from tests.kit.waiting import scaled

pytestmark = [
    pytest.mark.skipif(Adapter.RCLPY not in installed(), reason=NO_ROS),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]
NESTED = "test_msgs/msg/Nested"


@pytest.fixture(scope="module", autouse=True)
def robot(domain_id: int) -> Iterator[None]:
    local = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with running_script("genuine_rclpy.py", str(domain_id), environment=local):
        yield


async def test_a_message_is_decoded_with_definitions_of_its_node(domain_id: int, tmp_path: Path) -> None:
    settings = JoinSettings(node="bridge", domain_id=domain_id, interfaces=("127.0.0.1",))
    graph = await join(TypeStore(), settings)
    try:
        with pytest.raises(UnknownType):
            TypeStore().resolve(NESTED)

        retrieved = await definition_retrieval.retrieve(graph, "/nested", 30, scaled(30))
        assert set(retrieved) == {"test_msgs/msg/Nested.msg", "test_msgs/msg/BasicTypes.msg"}
        with pytest.raises(GraphError, match="/nothing cannot be retrieved: no node uses it"):
            await definition_retrieval.retrieve(graph, "/nothing", discovery_s=0.1)
    finally:
        await graph.close()
    definition_retrieval.write(retrieved, tmp_path)
    graph = await join(TypeStore([tmp_path]), settings)
    try:
        got: asyncio.Queue[Any] = asyncio.Queue()
        await graph.subscribe("/nested", NESTED, got.put_nowait)
        received = await asyncio.wait_for(got.get(), scaled(30))
        assert received.message["basic_types_value"]["int32_value"] == 7
        assert not graph.problems()
    finally:
        await graph.close()
