"""The expiry queue: one entry for each entity, cleaned when many were deleted."""

import asyncio
import time
from datetime import UTC, datetime

from handover_broker.model.entity import Entity, Event
from handover_broker.model.validation import timestamp
from handover_broker.storage.expiry_queue import LEFT_BEHIND, ExpiryQueue

AT = "2026-01-01T00:00:00.000000Z"


def at(seconds: float) -> str:
    return timestamp(datetime.fromtimestamp(seconds, UTC))


def transient(name: str, end: str | None) -> Entity:
    return Entity(f"urn:x:{name}", ("urn:x:Visitor",), {}, AT, AT, 1, (), end, end)


class Shelf:
    """A store as the queue uses it: entities by id, and staged changes."""

    def __init__(self) -> None:
        self.entities: dict[str, Entity] = {}
        self.staged: list[Event] = []

    def latest(self, entity_id: str) -> Entity | None:
        return self.entities.get(entity_id)

    def stage(self, event: Event) -> asyncio.Future[None]:
        self.staged.append(event)
        outcome: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        outcome.set_result(None)
        return outcome


def put(ends: ExpiryQueue, shelf: Shelf, entity: Entity) -> None:
    shelf.entities[entity.id] = entity
    ends.watch(shelf, entity)


def started(ends: ExpiryQueue) -> None:
    async def start() -> None:
        ends.start()
        await asyncio.sleep(0)
        ends.stop()

    asyncio.run(start())


def test_due_entities_expire_and_postponed_ones_stay() -> None:
    ends, shelf = ExpiryQueue(), Shelf()
    now = time.time()
    put(ends, shelf, transient("due", at(now - 1)))
    put(ends, shelf, transient("later", at(now + 1000)))
    put(ends, shelf, transient("put-off", at(now - 1)))
    put(ends, shelf, transient("put-off", at(now + 1000)))
    put(ends, shelf, transient("stays", at(now - 1)))
    shelf.entities["urn:x:stays"] = transient("stays", None)
    started(ends)
    assert [event.before.id for event in shelf.staged if event.before] == ["urn:x:due"]
    assert ends.waiting == 2


def test_deleted_and_frequently_changed_entities_do_not_fill_the_queue() -> None:
    ends, shelf = ExpiryQueue(), Shelf()
    far = time.time() + 10**6
    for number in range(3 * LEFT_BEHIND):
        put(ends, shelf, transient("beating", at(far + number)))
    assert ends.waiting == 1
    for number in range(3 * LEFT_BEHIND):
        put(ends, shelf, transient(f"gone{number}", at(far)))
        ends.forget(shelf, f"urn:x:gone{number}")
    assert ends.waiting <= 2 + LEFT_BEHIND
