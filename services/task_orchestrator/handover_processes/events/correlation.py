"""Correlation: which process, or which start event, gets a message or a signal.

A message goes to one receiver: a process that waits for its name and, where one of them has a key, for the
same key; the process that exchanged messages with the sender comes first, then the one that started first.
Without a waiting process, it starts the latest version of a definition whose start event has its name. A
signal goes to everyone.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from handover.telemetry import get_logger
from handover_bpmn.execution.queries import Subscription
from handover_bpmn.execution.state import WaitType
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.model import Definition, Kind, MessageEvent, SignalEvent
from handover_processes.process.process import Process

log = get_logger(__name__)

Name = tuple[WaitType, str]


@dataclass(frozen=True, slots=True)
class EventStart:
    """A start event of the latest version of a definition that waits for a message or a signal."""

    definition: str
    event: str


@dataclass
class WaitIndex:
    """The processes that wait for messages and signals, by name."""

    _waiting: dict[Name, dict[str, None]] = field(default_factory=dict)
    _names: dict[str, frozenset[Name]] = field(default_factory=dict)

    def update(self, process: Process) -> frozenset[Name]:
        """Index what a process waits for now; return the names that are new."""
        before = self._names.get(process.record.id, frozenset())
        self.remove(process.record.id)
        if process.run is None:
            return frozenset()
        names = frozenset(
            (subscription.type, subscription.name) for subscription in process.run.subscriptions()
        )
        for name in names:
            self._waiting.setdefault(name, {})[process.record.id] = None
        if names:
            self._names[process.record.id] = names
        return names - before

    def remove(self, process_id: str) -> None:
        """Forget a process."""
        for name in self._names.pop(process_id, ()):
            waiting = self._waiting[name]
            del waiting[process_id]
            if not waiting:
                del self._waiting[name]

    def waiting(self, type_: WaitType, name: str) -> list[str]:
        """Return the ids of the processes that wait for `name`."""
        return list(self._waiting.get((type_, name), ()))


def event_starts(definition: Definition) -> Iterator[tuple[Name, EventStart]]:
    """Yield the start events of a definition that wait for a message or signal, by its name."""
    for node in definition.scope.nodes.values():
        if node.kind is not Kind.START_EVENT or not isinstance(node.event, MessageEvent | SignalEvent):
            continue
        type_ = WaitType.MESSAGE if isinstance(node.event, MessageEvent) else WaitType.SIGNAL
        try:
            name = str(node.event.name.value({}))
        except ExpressionError as error:
            log.warning("start event has no name yet", definition=definition.name, error=str(error))
            continue
        yield (type_, name), EventStart(definition.name, node.id)


@dataclass(frozen=True, slots=True)
class Receiver:
    """A process that waits for a message or a signal, and its wait."""

    process: Process
    subscription: Subscription


def receivers(
    processes: Iterable[Process], type_: WaitType, name: str, matches: Callable[[Process, Subscription], bool]
) -> list[Receiver]:
    """Return the waits for `name` of `processes` whose process and key match, in the order of their start."""
    matching = [
        Receiver(process, subscription)
        for process in processes
        if process.run is not None
        for subscription in process.run.subscriptions()
        if subscription.type is type_ and subscription.name == name and matches(process, subscription)
    ]
    return sorted(
        matching, key=lambda receiver: (receiver.process.record.started_at, receiver.process.record.id)
    )


def matches_key(process: Process, subscription: Subscription, key: Any) -> bool:
    """Return whether a message with `key` is for a subscription of a process.

    A wait without a key takes a message without one, or with the business key of the (called) process.
    """
    if subscription.key is not None:
        return key is not None and str(subscription.key) == str(key)
    return key is None or (subscription.business_key or process.record.key) == str(key)
