"""Events: what an event of a process waits for or throws."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final, TypeAlias

import orjson

from handover_bpmn.languages.base import Expression, Json
from handover_bpmn.model.values import Value

KEY_LENGTH: Final = 32
"""Characters of the key of an entity filter."""


class TimerType(StrEnum):
    """The three kinds of timers; the value is the name of the BPMN element."""

    DATE = "timeDate"
    DURATION = "timeDuration"
    CYCLE = "timeCycle"


@dataclass(frozen=True, slots=True)
class TimerEvent:
    """Due at a moment, after a duration, or repeatedly (`R3/PT1M`, or cron)."""

    type: TimerType
    value: Value


@dataclass(frozen=True, slots=True)
class EntityFilter:
    """The NGSI-LD entities whose creation or change is the message, signal or condition (`handover:on`)."""

    type: str
    id_pattern: str | None = None
    q: str | None = None
    variable: str = "entity"
    """The variable that gets the entity, in simplified (keyValues) form."""
    correlation: Expression | None = None
    """Its value for an entity must equal the key of the event or, without one, that of the process."""

    @property
    def key(self) -> str:
        """Return the id of what is selected: filters that select the same entities have the same."""
        selected = orjson.dumps([self.type, self.id_pattern, self.q])
        return hashlib.sha256(selected).hexdigest()[:KEY_LENGTH]

    def correlated(self, entity: Mapping[str, Any]) -> Json:
        """Return the key that `entity` is for; None if it has none.

        Raises `ExpressionError` if the correlation cannot be evaluated for this entity.
        """
        return None if self.correlation is None else self.correlation.value({self.variable: entity})


@dataclass(frozen=True, slots=True)
class MessageEvent:
    """A message; `correlation` is the key that sender and receiver must agree on (None: any)."""

    name: Value
    correlation: Value | None = None
    on: EntityFilter | None = None


@dataclass(frozen=True, slots=True)
class SignalEvent:
    """A signal: everyone who waits for its name gets it."""

    name: Value
    on: EntityFilter | None = None


@dataclass(frozen=True, slots=True)
class ErrorEvent:
    """An error; without `code` it catches every error. The variables get code and reason of a caught one."""

    code: str | None = None
    code_variable: str | None = None
    message_variable: str | None = None


@dataclass(frozen=True, slots=True)
class EscalationEvent:
    """An escalation; without `code` it catches every escalation."""

    code: str | None = None
    code_variable: str | None = None


@dataclass(frozen=True, slots=True)
class ConditionalEvent:
    """Occurs when `condition` becomes true; with `on`, when it becomes true for an entity."""

    condition: Expression
    on: EntityFilter | None = None


@dataclass(frozen=True, slots=True)
class CompensateEvent:
    """Compensation: of `activity`, or of all completed activities of the scope."""

    activity: str | None = None


@dataclass(frozen=True, slots=True)
class LinkEvent:
    """A link: the throwing event continues at the catching one of the same name and scope."""

    name: str


@dataclass(frozen=True, slots=True)
class TerminateEvent:
    """Ends its scope with all its tokens."""


Event: TypeAlias = (
    TimerEvent
    | MessageEvent
    | SignalEvent
    | ErrorEvent
    | EscalationEvent
    | ConditionalEvent
    | CompensateEvent
    | LinkEvent
    | TerminateEvent
)
"""The definition of an event; an event without one is a none event."""
