"""How the client reads answers: what is final, what is repeated, and what a partial success left out."""

import httpx
import pytest

from handover.broker import (
    AlreadyExists,
    BrokerClient,
    BrokerError,
    BrokerFault,
    BrokerUnavailable,
    BrokerUnreachable,
    NotFound,
)
from handover.broker.identity import CONTEXT_PATH
from handover.settings import Settings
from handover_datamodels.contexts import handover_context

LAMP = "urn:ngsi-ld:Device:demo:lamp-1"


def client(status: int, body: object = None) -> BrokerClient:
    """Return a client of a broker of ours that gives one answer."""

    def answer(request: httpx.Request) -> httpx.Response:
        if request.url.path == CONTEXT_PATH:
            return httpx.Response(200, json=handover_context())
        return httpx.Response(status, json=body)

    return BrokerClient(Settings(_env_file=None), transport=httpx.MockTransport(answer))


@pytest.mark.parametrize(
    ("kind", "statuses"),
    [
        (BrokerError, [400, 403, 405, 413, 415, 422, 501, 505]),
        (NotFound, [404]),
        (AlreadyExists, [409]),
        (BrokerUnavailable, [302, 401, 408, 425, 429, 502, 503, 504, 507]),
        (BrokerFault, [500, 506, 508, 520, 599]),
    ],
)
async def test_each_refusal_is_final_or_of_the_moment_or_a_fault(
    kind: type[BrokerError], statuses: list[int]
) -> None:
    for status in statuses:
        with pytest.raises(BrokerError) as raised:
            await client(status).retrieve(LAMP)
        assert type(raised.value) is kind, status


async def test_without_an_answer_the_broker_is_unreachable() -> None:
    def refuse(_: httpx.Request) -> httpx.Response:
        raise httpx.ConnectError("refused")

    async with BrokerClient(Settings(_env_file=None), transport=httpx.MockTransport(refuse)) as broker:
        with pytest.raises(BrokerUnreachable):
            await broker.retrieve(LAMP)


@pytest.mark.parametrize(
    "left",
    [
        {"attributeName": "state", "reason": "there is none"},
        {"statusCode": 404, "title": "there is none", "attributes": ["state"]},
    ],
    ids=["the standard", "Orion-LD"],
)
async def test_attributes_that_were_not_updated_are_named(left: dict[str, object]) -> None:
    broker = client(207, {"updated": [], "notUpdated": [left]})
    with pytest.raises(BrokerError, match="state: there is none"):
        await broker.update(LAMP, {"state": {"type": "Property", "value": "on"}})


@pytest.mark.parametrize(
    ("statuses", "kind"),
    [
        ([400, 500], BrokerFault),
        ([400, 500, 503], BrokerUnavailable),
        ([400, 501], BrokerError),
        ([None], BrokerError),
    ],
)
async def test_a_batch_that_failed_in_part_is_repeated_if_a_part_may_succeed(
    statuses: list[int | None], kind: type[BrokerError]
) -> None:
    errors = [{"entityId": LAMP, "error": {"status": status, "title": "no"}} for status in statuses]
    with pytest.raises(BrokerError) as raised:
        await client(207, {"success": [], "errors": errors}).upsert([{"id": LAMP, "type": "Device"}])
    assert type(raised.value) is kind
