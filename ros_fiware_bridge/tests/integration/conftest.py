"""A cell with a broker and a ROS bridge, both processes, and a robot on a ROS graph of its own."""

import textwrap
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient, BrokerError
from handover.settings import Settings

pytest.importorskip("cyclonedds", reason="the extra [ros] is not installed")

from handover_ros.graph.joining import JoinSettings, join
from handover_ros.graph.port import Publisher, Received, Subscription
from handover_ros.graph.qos import DEFAULT, Qos
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.integration.shared_mapping import BOTH_WAYS, REQUESTS
from tests.kit.cell import new_cell
from tests.kit.ros_domains import ros_domain
from tests.kit.waiting import scaled, until


class Shop:
    """A broker and a bridge as processes, and `robot`, a node on the graph that they share."""

    def __init__(self, cell: Any, domain: int) -> None:
        self.cell = cell
        self.domain = domain
        self.robot: Any = None
        self.broker: Any = None

    def begin(self, mapping: str, **settings: str) -> None:
        """Start the broker, if it does not run, and the bridge with `mapping`."""
        file = self.cell.data_dir / "mapping.yaml"
        file.write_text(textwrap.dedent(mapping))
        self.cell.extra.update(
            {
                "HANDOVER_ROS_MAPPING": str(file),
                "HANDOVER_ROS_DOMAIN_ID": str(self.domain),
                "HANDOVER_ROS_INTERFACES": '["127.0.0.1"]',
                **settings,
            }
        )
        if "context_broker" not in self.cell.processes:
            self.cell.start("context_broker", within_s=90.0)
        self.cell.start("ros_fiware_bridge", within_s=90.0)  # it loads a middleware

    @asynccontextmanager
    async def opened(self) -> AsyncIterator[None]:
        """Open a client of the broker, and join the graph as the robot."""
        asked = JoinSettings(node="robot", domain_id=self.domain, interfaces=("127.0.0.1",))
        self.robot = await join(TypeStore(), asked)
        try:
            settings = Settings.load(broker_url=self.cell.url("context_broker"))
            async with BrokerClient(settings) as self.broker:
                yield
        finally:
            await self.robot.close()

    async def publisher(self, topic: str, type_name: str, qos: Qos = DEFAULT) -> Publisher:
        """Return a publisher of the robot that has a subscriber."""
        publisher = await self.robot.publisher(topic, type_name, qos)
        assert await publisher.matched(scaled(10.0)), f"no node subscribes to {topic}"
        return publisher

    async def subscribe(
        self, topic: str, type_name: str, qos: Qos = DEFAULT
    ) -> tuple[Subscription, list[Any]]:
        """Return a subscription of the robot that has a publisher, and the list of its messages."""
        messages: list[Any] = []

        def on_message(received: Received) -> None:
            messages.append(received.message)

        subscription = await self.robot.subscribe(topic, type_name, on_message, qos)
        assert await subscription.matched(scaled(10.0)), f"no node publishes {topic}"
        return subscription, messages

    def rule(self, name: str) -> dict[str, Any]:
        """Return the view of a rule."""
        answer = httpx.get(f"{self.cell.url('ros_fiware_bridge')}/rules/{name}", timeout=120)
        assert answer.is_success, answer.text
        found: dict[str, Any] = answer.json()
        return found

    def post(self, path: str) -> httpx.Response:
        """Send a POST request to the bridge."""
        return httpx.post(f"{self.cell.url('ros_fiware_bridge')}{path}", timeout=120)

    async def until(self, condition: Callable[[], Any], within_s: float = 30.0, why: str = "") -> Any:
        """Wait until the result of `condition` is true; return it."""
        return await until(condition, within_s, lambda: f"{why or 'timeout'}: {self._log()}")

    async def value(self, entity_id: str, attribute: str) -> Any:
        """Return the value of an attribute; None if there is none."""
        try:
            entity = await self.broker.retrieve(entity_id)
        except BrokerError:
            return None
        return entity.get(attribute, {}).get("value")

    async def next_check(self) -> None:
        """Wait until the bridge has checked all topics from beginning to end."""
        before = self._checks()
        await self.until(lambda: self._checks() >= before + 2, why="the bridge does not check its topics")

    def _checks(self) -> int:
        metrics = httpx.get(f"{self.cell.url('ros_fiware_bridge')}/metrics", timeout=120).text
        (line,) = (one for one in metrics.splitlines() if one.startswith("handover_bridge_checks_total "))
        return int(float(line.split()[1]))

    async def becomes(self, entity_id: str, attribute: str, value: Any, within_s: float = 15.0) -> None:
        """Wait until an attribute has a value."""

        async def is_there() -> bool:
            return bool(await self.value(entity_id, attribute) == value)

        await self.until(is_there, within_s, f"{attribute} of {entity_id} never became {value}")

    def _log(self) -> str:
        return str(self.cell.log("ros_fiware_bridge")[-3000:])


@pytest.fixture(scope="session")
def shared_shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    """A broker and a bridge with the shared mapping, for the modules that need no other."""
    with new_cell(tmp_path_factory.mktemp("cell")) as cell:
        made = Shop(cell, ros_domain())
        made.begin(BOTH_WAYS + REQUESTS)
        yield made


@pytest.fixture(scope="module")
def at_work(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    """A broker and a bridge with the `MAPPING` of the module, for all its tests."""
    with new_cell(tmp_path_factory.mktemp("cell")) as cell:
        made = Shop(cell, ros_domain())
        try:
            made.begin(request.module.MAPPING)
            yield made
        finally:
            cell.stop()


@pytest.fixture
async def shop(at_work: Shop) -> AsyncIterator[Shop]:
    """The module's broker and bridge, with a robot on the graph."""
    async with at_work.opened():
        yield at_work


@pytest.fixture
async def own_shop(cell: Any) -> AsyncIterator[Shop]:
    """A shop without processes, whose robot has joined the graph."""
    made = Shop(cell, ros_domain())
    async with made.opened():
        yield made
