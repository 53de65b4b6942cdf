"""Data of persons are deleted from any broker, or an Alert says what remains there."""

from collections.abc import Iterator

import pytest

from handover.alerts.reporting_writer import reporting_writer
from handover.broker import BrokerClient, NotFound
from handover_body.exchange.deletions import Deletions
from tests.kit.cell import Cell
from tests.kit.refusing_proxy import RefusingProxy, refusing_proxy
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

NAMES = [f"urn:ngsi-ld:HumanState:demo:P-{number}" for number in range(3)]
STUCK, *OTHERS = NAMES


@pytest.fixture
def proxy(cell: Cell) -> Iterator[RefusingProxy]:
    cell.start("context_broker")
    with refusing_proxy(cell.url("context_broker")) as made:
        yield made


async def is_gone(broker: BrokerClient, name: str) -> bool:
    try:
        await broker.retrieve(name)
    except NotFound:
        return True
    return False


async def alert(broker: BrokerClient, kind: str) -> str | None:
    found = await broker.query(type="Alert", q=f'subCategory=="{kind}"')
    return str(found[0]["description"]["value"]) if found else None


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("refused", "status", "kind", "remains"),
    [
        (f"DELETE /ngsi-ld/v1/entities/{STUCK}", 500, "writeFailed", True),
        (f"DELETE /ngsi-ld/v1/entities/{STUCK}", 501, "deletionRefused", True),
        ("DELETE /ngsi-ld/v1/temporal", 501, "deletionRefused", False),
    ],
    ids=["it fails at one", "it cannot delete one", "it has no history"],
)
async def test_a_deletion_that_the_broker_does_not_perform_is_an_alert_and_delays_no_other(
    cell: Cell, proxy: RefusingProxy, *, refused: str, status: int, kind: str, remains: bool
) -> None:
    proxy.refused, proxy.status = frozenset({refused.encode()}), status
    settings = cell.settings.model_copy(update={"broker_url": proxy.url})
    async with BrokerClient(settings) as broker, reporting_writer("human-state", settings, broker) as writer:
        deletions = Deletions(settings, broker, writer)
        await broker.upsert([{"id": name, "type": "HumanState"} for name in NAMES])
        for name in NAMES:
            deletions.put(name)
        for name in OTHERS:
            await until(lambda: is_gone(broker, name))  # noqa: B023
        said = await until(lambda: alert(broker, kind))
        assert STUCK in said
        assert await is_gone(broker, STUCK) is not remains
