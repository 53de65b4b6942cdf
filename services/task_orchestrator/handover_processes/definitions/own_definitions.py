"""Own definitions: writes ProcessDefinitions and TaskDefinitions of ours, and never those of other systems.

An entity that another system has written or changed stays as it is, also when a write is repeated after a
crash: it is offered to an engineer instead.
"""

from collections.abc import Sequence
from typing import Any

from handover.broker import BrokerClient
from handover.files.content_digest import digest_of, is_ours
from handover.subscriptions.notifications import MAX_IDS_PER_QUERY


async def write_definitions(broker: BrokerClient, entities: Sequence[dict[str, Any]]) -> None:
    """Write the definitions that the broker does not have, or has as we wrote them earlier."""
    for start in range(0, len(entities), MAX_IDS_PER_QUERY):
        some = entities[start : start + MAX_IDS_PER_QUERY]
        types = sorted({entity["type"] for entity in some})
        stored = await broker.query(type=types, id=[entity["id"] for entity in some])
        present = {entity["id"]: entity for entity in stored}
        outdated = [entity for entity in some if _is_outdated(present.get(entity["id"]), entity)]
        if outdated:
            await broker.replace(outdated)


def _is_outdated(present: dict[str, Any] | None, entity: dict[str, Any]) -> bool:
    if present is None:
        return True
    return is_ours(present) and digest_of(present) != digest_of(entity)
