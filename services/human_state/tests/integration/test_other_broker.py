"""Human state on a broker that keeps one value of each attribute and has no history, as Orion-LD."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from handover.broker import BrokerClient
from handover.broker.identity import BrokerIdentity
from services.human_state.tests.integration.conftest import HEART_RATE, Running, consent
from tests.kit.cell import Cell
from tests.kit.other_broker.running import orion_like
from tests.kit.waiting import until

pytestmark = pytest.mark.slow


@pytest.fixture
def orion(shared_cell: Cell, tmp_path: Path) -> Iterator[str]:
    """The URL of a broker that speaks as Orion-LD."""
    with orion_like(shared_cell.environment, tmp_path) as url:
        yield url


@pytest.mark.nightly
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
        assert await broker.identity() == BrokerIdentity("Orion-LD", "1.6.0")
        assert (await own.identity()).is_ours
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


@pytest.mark.nightly
async def test_without_a_yes_no_body_signal_is_written_there(
    running: Running, shared_cell: Cell, orion: str, capsys: pytest.CaptureFixture[str]
) -> None:
    there = {
        "broker_url": orion,
        "broker_tenant": None,
        "context_url": f"{shared_cell.url('context_broker')}/context.jsonld",
    }
    settings = shared_cell.settings.model_copy(update=there)
    async with running(**there, health_on_other_broker=False) as rest, BrokerClient(settings) as broker:
        (await rest.put("/people/eino", json={"age": 40})).raise_for_status()
        (await rest.put("/people/eino/consent", json=consent())).raise_for_status()
        sensor = {"person": "eino", "driver": "simulated", "settings": HEART_RATE}
        (await rest.put("/sensors/strap-eino", json=sensor)).raise_for_status()
        await until(lambda: "HANDOVER_HEALTH_ON_OTHER_BROKER" in "".join(capsys.readouterr()), 120)
        assert await broker.query(type="HumanState") == []
