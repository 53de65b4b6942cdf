"""Outbox: changes that are stored in the database are written to the broker until it accepts them.

Messages of one stream (one process) are delivered in order, streams in parallel. While the broker is
unavailable they wait. A message that the broker refuses is reported to the orchestrator. After a crash a
message may be delivered twice; every kind of message is idempotent.

A Task waits until the broker has acknowledged its TaskDefinition, so that a performer never sees a Task
before its definition. The message of a definition that the broker refuses stays in the database. Each Task of
it tries to write it once more, and is rejected, not posted, while the broker refuses it.

A Task that needs a row of the specification database is one message, which writes the row and then the Task.

New and updated entities of many streams are written together: a round takes the first messages of the streams
that are ready, and writes all new entities in one request, then all updated ones. A message that fails within
a round is delivered alone, with retries, before its stream takes part in a round again.
"""

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any, Self

from prometheus_client import Counter, Gauge

from handover.alerts import clear_alert, raise_alert
from handover.alerts.catalogue import AlertType
from handover.broker import (
    MAX_FAULTS,
    AlreadyExists,
    BrokerClient,
    BrokerError,
    BrokerFault,
    BrokerUnavailable,
    NotFound,
    fault_delay_s,
)
from handover.errors import HandoverError, Problem
from handover.messages import message, message_in, text_of
from handover.runtime.background_tasks import BackgroundTasks
from handover.runtime.retry import MAX_DELAY_S, Backoff
from handover.settings import Settings
from handover.telemetry import get_logger
from handover_datamodels.states import Severity
from handover_processes.definitions.own_definitions import write_definitions
from handover_processes.records.messages import Message, MessageKind
from handover_processes.records.specification_writer import (
    SpecificationRefused,
    SpecificationsUnavailable,
    SpecificationWriter,
)

log = get_logger(__name__)

INITIAL_RETRY_S = 0.05
MAX_BATCH = 100
"""Messages in one request."""
ROUNDS = 2
"""Concurrent rounds; a stream takes part in one at a time."""

PENDING = Gauge("handover_orchestrator_outbox_messages", "Messages that the broker has not accepted yet")
REJECTED = Counter(
    "handover_orchestrator_outbox_rejected_total", "Messages that the broker rejected, by kind", ["kind"]
)

_BATCHED = frozenset({MessageKind.CREATE, MessageKind.UPSERT})
OnRejected = Callable[[Message, str], Awaitable[None]]


class Outbox:
    """Delivers messages; an asynchronous context manager.

    `on_rejected` is awaited for each message that the broker rejects; it raises `Problem` if that cannot be
    stored. Before each delivery `may_deliver` is awaited. Leaving the context stops the delivery; messages
    that were not delivered stay in the database.
    """

    def __init__(
        self,
        settings: Settings,
        broker: BrokerClient,
        on_rejected: OnRejected,
        *,
        may_deliver: Callable[[], Awaitable[None]],
    ) -> None:
        self._settings = settings
        self._broker = broker
        self._on_rejected = on_rejected
        self._may_deliver = may_deliver
        self._streams: dict[str, deque[Message]] = {}
        self._ready: dict[str, None] = {}
        """Streams whose next message is in no round and in no delivery of its own."""
        self._has_ready = asyncio.Event()
        self._tasks = BackgroundTasks("outbox")
        self._specifications = SpecificationWriter(settings, broker)
        self._delivered: list[int] = []
        self._pending: dict[str, int] = {}
        self._definitions: dict[str, int] = {}
        """Definitions that were not written yet, with the number of messages that have them."""
        self._refused: dict[str, _RefusedDefinition] = {}
        """TaskDefinitions that the broker has refused, by id."""
        self._waiting: dict[str, set[str]] = {}
        """Streams whose next message waits for a definition, by that definition."""
        self._retry_now = asyncio.Event()
        self.has_delivered = asyncio.Event()

    async def __aenter__(self) -> Self:
        await self._specifications.__aenter__()
        await self._tasks.__aenter__()
        for _ in range(ROUNDS):
            self._tasks.start(self._deliver_rounds)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__()
        await self._specifications.__aexit__()

    def send(self, messages: Iterable[Message]) -> None:
        """Deliver `messages`, which are stored in the database, from now on."""
        for added in messages:
            self._pending[added.subject] = self._pending.get(added.subject, 0) + 1
            PENDING.inc()
            for definition in _definitions_in(added):
                self._definitions[definition] = self._definitions.get(definition, 0) + 1
            if added.stream in self._streams:
                self._streams[added.stream].append(added)
            else:
                self._streams[added.stream] = deque([added])
                self._set_ready(added.stream)

    def is_pending(self, subject: str) -> bool:
        """Return whether a message about the entity `subject` was not delivered yet."""
        return subject in self._pending

    def take_delivered(self) -> list[int]:
        """Return the numbers of the messages that were delivered since the last call, to delete them."""
        delivered, self._delivered = self._delivered, []
        self.has_delivered.clear()
        return delivered

    def restore_delivered(self, delivered: list[int]) -> None:
        """Undo `take_delivered`: the messages could not be deleted."""
        self._delivered += delivered
        if delivered:
            self.has_delivered.set()

    def retry_now(self) -> None:
        """Retry what waits: the broker is available again."""
        self._retry_now.set()
        self._retry_now = asyncio.Event()

    def _set_ready(self, stream: str) -> None:
        self._ready[stream] = None
        self._has_ready.set()

    async def _deliver_rounds(self) -> None:
        while True:
            await self._has_ready.wait()
            await self._may_deliver()
            streams = list(islice(self._ready, MAX_BATCH))
            for stream in streams:
                del self._ready[stream]
            if not self._ready:
                self._has_ready.clear()
            await self._deliver_round(streams)

    async def _deliver_round(self, streams: list[str]) -> None:
        streams = [stream for stream in streams if not self._waits_for_definition(stream)]
        failed = await self._deliver_first(MessageKind.CREATE, streams)
        failed |= await self._deliver_first(
            MessageKind.UPSERT, [name for name in streams if name not in failed]
        )
        for stream in streams:
            messages = self._streams[stream]
            if not messages:
                del self._streams[stream]
            elif (
                stream in failed
                or messages[0].kind not in _BATCHED
                or _definition_of(messages[0]) in self._refused
            ):
                self._tasks.start(self._deliver_alone, stream)
            else:
                self._set_ready(stream)

    def _waits_for_definition(self, stream: str) -> bool:
        """Return whether the next message of a stream waits; the delivery of the definition sets it ready."""
        awaited = self._awaited_definition(self._streams[stream][0])
        if awaited is None:
            return False
        self._waiting.setdefault(awaited, set()).add(stream)
        return True

    def _awaited_definition(self, message: Message) -> str | None:
        defined_by = _definition_of(message) if self._definitions else None
        return defined_by if defined_by in self._definitions else None

    async def _deliver_first(self, kind: MessageKind, streams: list[str]) -> set[str]:
        """Write the messages of one kind that come first in `streams`; return the streams of failed ones."""
        batch: list[Message] = []
        for stream in streams:
            subjects: set[str] = set()
            for waiting in self._streams[stream]:
                if waiting.kind is not kind or waiting.subject in subjects or len(batch) == MAX_BATCH:
                    break
                if self._awaited_definition(waiting) is not None or _definition_of(waiting) in self._refused:
                    break  # the latter is delivered alone
                subjects.add(waiting.subject)
                batch.append(waiting)
        undelivered = await self._write_batch(kind, batch)
        failed: set[str] = set()
        for outgoing in batch:
            if outgoing.seq in undelivered:
                failed.add(outgoing.stream)
            elif outgoing.stream not in failed:
                self._mark_delivered(self._streams[outgoing.stream].popleft())
        return failed

    async def _write_batch(self, kind: MessageKind, batch: list[Message]) -> set[int]:
        """Write messages in one request; return the numbers of those to deliver alone."""
        every = {message.seq for message in batch}
        try:
            if len(batch) < 2:
                for message in batch:
                    await self._write(message)
                return set()
            bodies = [message.body if kind is MessageKind.UPSERT else [message.body] for message in batch]
            entities = list(chain.from_iterable(bodies))
            is_new = kind is MessageKind.CREATE
            write = self._broker.create_batch if is_new else self._broker.upsert_batch
            refused = await write(entities)
        except BrokerError:
            return every  # each shows its own reason when it is delivered alone
        except Exception:
            log.exception(
                "messages not delivered together", subjects=[outgoing.subject for outgoing in batch]
            )
            return every
        return {
            message.seq
            for message, body in zip(batch, bodies, strict=True)
            if any(entity["id"] in refused for entity in body)
        }

    async def _deliver_alone(self, stream: str) -> None:
        messages = self._streams[stream]
        try:
            await self._deliver(messages[0])
        except Exception:
            REJECTED.labels(messages[0].kind).inc()
            log.exception("message dropped", subject=messages[0].subject)
        self._mark_delivered(messages.popleft())
        if messages:
            self._set_ready(stream)
        else:
            del self._streams[stream]

    async def _deliver(self, message: Message) -> None:
        backoff = Backoff(INITIAL_RETRY_S, MAX_DELAY_S)
        faults = 0
        while True:
            await self._may_deliver()
            try:
                await self._write(message)
            except BrokerUnavailable as error:
                is_fault = isinstance(error, BrokerFault)
                faults += is_fault
                if faults >= MAX_FAULTS and await self._report_rejected(message, error):
                    return
                log.warning("broker unavailable, message waits", subject=message.subject, error=str(error))
                await self._wait(fault_delay_s(faults) if is_fault else backoff.next_delay_s())
            except SpecificationsUnavailable:
                await self._wait(backoff.next_delay_s())
            except (BrokerError, SpecificationRefused, _DefinitionRefused) as error:
                if await self._report_rejected(message, error):
                    return
                await self._wait(MAX_DELAY_S)
            else:
                return

    async def _report_rejected(self, message: Message, error: HandoverError) -> bool:
        """Report that `message` was rejected; return whether the report was stored."""
        REJECTED.labels(message.kind).inc()
        log.error("message rejected", subject=message.subject, kind=message.kind, error=str(error))
        try:
            await self._on_rejected(message, text_of(error))
        except Problem as problem:
            log.warning("rejection not stored yet", error=str(problem))
            return False
        return True

    async def _write(self, message: Message) -> None:
        match message.kind:
            case MessageKind.CREATE:
                await self._create(message, message.body)
            case MessageKind.SPECIFY:
                task = message.body.get("task")
                if task is not None:
                    await self._require_definition(_definition_of(message))
                await self._specifications.write(message.body["row"])
                if task is not None:
                    await self._create(message, task)
            case MessageKind.UPSERT:
                await self._broker.upsert(message.body)
            case MessageKind.DEFINE:
                await self._define(message)
            case MessageKind.APPEND:
                try:
                    await self._broker.append(message.subject, message.body)
                except NotFound:
                    log.warning("entity does not exist", subject=message.subject)
            case MessageKind.DELETE:
                await self._broker.delete_batch(message.body)
            case MessageKind.RAISE:
                body = message.body
                await raise_alert(
                    self._broker,
                    self._settings,
                    AlertType(body["category"], body["sub_category"], Severity(body["severity"])),
                    key=body["key"],
                    source=body["source"],
                    description=message_in(body, "description") or "",
                )
            case MessageKind.CLEAR:
                await clear_alert(self._broker, self._settings, **message.body)

    async def _create(self, message: Message, entity: dict[str, Any]) -> None:
        await self._require_definition(_definition_of(message))
        try:
            await self._broker.create(entity)
        except AlreadyExists:
            log.debug("entity exists", subject=message.subject)

    async def _define(self, message: Message) -> None:
        """Write definitions; keep which TaskDefinitions the broker refuses."""
        try:
            await write_definitions(self._broker, message.body)
        except BrokerUnavailable:
            raise
        except BrokerError as error:
            log.warning("definitions not written together", subject=message.subject, error=str(error))
            for entity in message.body:
                await self._define_alone(message, entity)
        else:
            for entity in message.body:
                self._accept_definition(entity["id"])

    async def _define_alone(self, message: Message, entity: dict[str, Any]) -> None:
        try:
            await write_definitions(self._broker, [entity])
        except BrokerUnavailable:
            raise
        except BrokerError as error:
            REJECTED.labels(message.kind).inc()
            log.warning("definition rejected", subject=entity["id"], error=str(error))
            if entity["type"] == "TaskDefinition":
                self._accept_definition(entity["id"])  # an earlier version of it
                self._refused[entity["id"]] = _RefusedDefinition(message.seq, entity)
        else:
            self._accept_definition(entity["id"])

    def _accept_definition(self, definition: str) -> None:
        """Delete the message of a refused definition once the broker has all definitions of it."""
        refused = self._refused.pop(definition, None)
        if refused is not None and not any(other.seq == refused.seq for other in self._refused.values()):
            self._delivered.append(refused.seq)
            self.has_delivered.set()

    async def _require_definition(self, definition: str | None) -> None:
        """Try once more to write a refused definition; raise `_DefinitionRefused` if it still is refused."""
        refused = None if definition is None else self._refused.get(definition)
        if definition is None or refused is None:
            return
        try:
            await write_definitions(self._broker, [refused.entity])
        except BrokerUnavailable:
            raise
        except BrokerError as error:
            raise _DefinitionRefused(_why_refused(definition, error)) from error
        self._accept_definition(definition)

    def _mark_delivered(self, message: Message) -> None:
        PENDING.dec()
        if not any(other.seq == message.seq for other in self._refused.values()):
            self._delivered.append(message.seq)
        left = self._pending[message.subject] - 1
        if left:
            self._pending[message.subject] = left
        else:
            del self._pending[message.subject]
        for definition in _definitions_in(message):
            self._definitions[definition] -= 1
            if not self._definitions[definition]:
                del self._definitions[definition]
                for stream in self._waiting.pop(definition, ()):
                    self._set_ready(stream)
        self.has_delivered.set()

    async def _wait(self, seconds: float) -> None:
        try:
            async with asyncio.timeout(seconds):
                await self._retry_now.wait()
        except TimeoutError:
            return


@dataclass(frozen=True, slots=True)
class _RefusedDefinition:
    """A TaskDefinition that the broker has refused, with its message, which stays in the database."""

    seq: int
    entity: dict[str, Any]


class _DefinitionRefused(HandoverError):
    """The broker refuses the TaskDefinition of a Task."""


def _why_refused(definition: str, error: BrokerError) -> str:
    return message(
        "task.definition_refused",
        "the broker does not accept {definition}: {why}; correct the cause, or deploy the file with another "
        "definition, then retry",
        definition=definition,
        why=text_of(error),
    )


def _definition_of(message: Message) -> str | None:
    """Return the TaskDefinition of the Task that a message creates."""
    body = message.body.get("task") if message.kind is MessageKind.SPECIFY else message.body
    if message.kind not in {MessageKind.CREATE, MessageKind.SPECIFY} or not isinstance(body, Mapping):
        return None
    link = body.get("isDefinedBy")
    defined_by = link.get("object") if isinstance(link, Mapping) else None
    return defined_by if isinstance(defined_by, str) else None


def _definitions_in(message: Message) -> list[str]:
    """Return the ids of the definitions that a message writes."""
    return [entity["id"] for entity in message.body] if message.kind is MessageKind.DEFINE else []
