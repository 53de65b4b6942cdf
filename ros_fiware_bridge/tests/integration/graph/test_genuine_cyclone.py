"""Our DDS against nodes of `rmw_cyclonedds_cpp`: they publish hashes of request and response messages."""

from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

pytest.importorskip("cyclonedds")

from handover_ros.errors import TypeHashDiffers
from handover_ros.graph.joining import Adapter, JoinSettings, join
from handover_ros.graph.port import GoalStatus, RosGraph
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.integration.graph.conftest import running_script, true
from tests.kit.waiting import scaled

TRIGGER = "std_srvs/srv/Trigger"
OF_REQUEST = "RIHS01_d010825374ce8918e72bfd826c82603e60f45419e932ea976f807b74a863a199"
OF_RESPONSE = "RIHS01_2d946c21e2fc3f1e9ca6986a8191d85fcc70097a8bb7771a053564bc47009cdf"
OF_SERVICE = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"


@contextmanager
def genuine(domain_id: int, *arguments: str) -> Iterator[None]:
    with running_script("genuine_cyclone.py", str(domain_id), *arguments):
        yield


@pytest.fixture
async def graph(store: TypeStore, domain_id: int) -> AsyncIterator[RosGraph]:
    settings = JoinSettings(node="bridge", domain_id=domain_id, interfaces=("127.0.0.1",))
    opened = await join(store, settings, Adapter.CYCLONE)
    yield opened
    await opened.close()


@pytest.mark.nightly
async def test_a_service_and_an_action_of_a_genuine_node_are_called(graph: RosGraph, domain_id: int) -> None:
    with genuine(domain_id):
        assert await graph.call("/trigger", TRIGGER, {}, scaled(20)) == {"success": True, "message": "done"}
        action = await graph.action_client("/fibonacci", "test_msgs/action/Fibonacci")
        ended = await (await action.send_goal({"order": 6}, timeout_s=120)).result(120)
        assert ended.status is GoalStatus.SUCCEEDED
        assert ended.result["sequence"].tolist() == [0, 1, 1, 2, 3, 5]
        # A callable server must not be reported as a problem.
        assert graph.problems() == []


async def test_the_hash_of_the_service_is_accepted_as_well(graph: RosGraph, domain_id: int) -> None:
    with genuine(domain_id, OF_SERVICE.removeprefix("RIHS01_")):
        assert (await graph.call("/trigger", TRIGGER, {}, scaled(20)))["success"]


async def test_another_definition_is_refused_and_both_our_hashes_are_named(
    graph: RosGraph, domain_id: int
) -> None:
    with genuine(domain_id, "0" * 64):
        await true(lambda: "/trigger" in {one.name for one in graph.services()})
        with pytest.raises(TypeHashDiffers, match=f"/trigger: .* serves {TRIGGER} with ") as error:
            await graph.call("/trigger", TRIGGER, {}, scaled(20))
        assert OF_REQUEST in str(error.value)
        assert OF_SERVICE in str(error.value)


async def test_our_endpoints_publish_the_same_hashes_as_genuine_ones(
    graph: RosGraph, store: TypeStore
) -> None:
    async def answer(_: dict[str, Any]) -> dict[str, Any]:
        return {"success": True}

    await graph.serve("/ours", TRIGGER, answer)
    assert await graph.call("/ours", TRIGGER, {}, scaled(20))

    def published() -> dict[tuple[str, bool], str | None]:
        snapshot = graph._node.discovery.snapshot()  # type: ignore[attr-defined]  # no port shows it
        return {(one.topic, one.writes): one.type_hash for one in snapshot.endpoints if "/ours" in one.topic}

    await true(lambda: len(published()) == 4)
    assert published() == {
        ("rq/oursRequest", True): OF_REQUEST,
        ("rq/oursRequest", False): OF_REQUEST,
        ("rr/oursReply", True): OF_RESPONSE,
        ("rr/oursReply", False): OF_RESPONSE,
    }
