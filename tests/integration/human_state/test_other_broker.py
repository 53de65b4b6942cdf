"""Human state on a broker that keeps one value of each attribute and has no history, as Orion-LD."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient
from handover.broker_identity import SOFTWARE, BrokerIdentity, identify
from tests.integration.human_state.conftest import HEART_RATE, Running, consent
from tests.kit import processes
from tests.kit.cell import Cell
from tests.kit.other_broker.profiles import ORION_LD
from tests.kit.other_broker.running import QUERY, OtherBroker
from tests.kit.ports import next_free_port
from tests.kit.waiting import until, wait_for

pytestmark = pytest.mark.slow


@pytest.fixture
def orion(shared_cell: Cell, tmp_path: Path) -> Iterator[str]:
    """The URL of a broker that speaks as Orion-LD."""
    port = next_free_port()
    broker = OtherBroker(port, tmp_path, ORION_LD.name, "")
    environment = {**shared_cell.environment, "HANDOVER_DATA_DIR": str(tmp_path / "broker")}
    process = broker.spawn(environment, tmp_path / "strict-broker.log")
    try:
        wait_for(lambda: answers(f"http://127.0.0.1:{port}{QUERY}"), 60, "the broker does not answer")
        yield f"http://127.0.0.1:{port}"
    finally:
        processes.stop(process)
        broker.stop()


def answers(url: str) -> bool:
    try:
        return httpx.get(url, timeout=120, trust_env=False).is_success
    except httpx.TransportError:
        return False


async def test_a_person_is_published_and_deleted_there_and_what_may_remain_is_an_alert(
    running: Running, shared_cell: Cell, orion: str
) -> None:
    there = {
        "broker_url": orion,
        "broker_tenant": None,
        "context_url": f"{shared_cell.url('context_broker')}/context.jsonld",
    }
    settings = shared_cell.settings.model_copy(update=there)
    async with (
        running(**there) as rest,
        BrokerClient(settings) as broker,
        BrokerClient(shared_cell.settings) as own,
    ):
        assert await identify(broker) == BrokerIdentity("Orion-LD", "1.6.0")
        assert (await identify(own)).name == SOFTWARE
        (await rest.put("/people/aino", json={"age": 40})).raise_for_status()
        (await rest.put("/people/aino/consent", json=consent())).raise_for_status()
        sensor = {"person": "aino", "driver": "simulated", "settings": HEART_RATE}
        (await rest.put("/sensors/strap-aino", json=sensor)).raise_for_status()

        async def published() -> dict[str, Any] | None:
            found = await broker.query(type="HumanState", attrs=["heartRate"])
            return found[0] if found else None

        entity = await until(published, 120)
        assert isinstance(entity["heartRate"], dict), "the fused value alone"
        assert "datasetId" not in entity["heartRate"]
        (await rest.delete("/people/aino/consent")).raise_for_status()

        async def is_gone() -> bool:
            return await published() is None

        await until(is_gone)

        async def alert() -> str | None:
            found = await broker.query(type="Alert", q='subCategory=="deletionRefused"')
            return str(found[0]["description"]["value"]) if found else None

        assert entity["id"] in await until(alert)
