"""Queries: what a process waits for and works on, as its callers see it; nothing is changed."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from itertools import islice
from typing import Any

from handover_bpmn.execution.machine import Machine
from handover_bpmn.execution.state import Frame, Token, TokenState, WaitType
from handover_bpmn.execution.waits import event_of
from handover_bpmn.model import Activity, EntityFilter, MultiInstance, entity_filter


@dataclass(frozen=True, slots=True)
class OpenActivity:
    """An activity that a performer works on: `visit` counts from 1, `variables` are those it sees."""

    token: str
    element: str
    """The id of the element; within a called process after those of the call activities."""
    visit: int
    activity: Activity
    variables: Mapping[str, Any] = field(repr=False)
    data: Mapping[str, Any] = field(default_factory=dict, repr=False)
    """The data objects that are inputs of the activity, by parameter."""
    instance: str = ""
    """Which instance of multi-instance activities it is, such as `2/5: bin-1`; empty outside of them."""


@dataclass(frozen=True, slots=True)
class OpenIncident:
    """A token that cannot continue."""

    token: str
    element: str
    name: str
    reason: str
    since: datetime
    stage: TokenState
    details: Mapping[str, Any]
    visit: int
    """The visit of its activity, as in the Task; 0 if it has none."""


@dataclass(frozen=True, slots=True)
class Subscription:
    """A message or signal that the process waits for; without `key`, whatever the correlation is."""

    wait: int
    type: WaitType
    name: str
    key: Any
    element: str
    business_key: str | None = None
    """The key of the called process that waits; None: that of the process itself."""


@dataclass(frozen=True, slots=True)
class EntityWait:
    """An event that the process waits for and that is the creation or change of an entity.

    `key` is that of a message that declares a correlation of its own.
    """

    wait: int
    type: WaitType
    name: str
    key: Any
    on: EntityFilter
    element: str
    holding: tuple[str, ...]
    """The entities for which the condition was true when it was last evaluated."""


@dataclass(frozen=True, slots=True)
class OpenToken:
    """A token: where it is, and what it does there."""

    token: str
    element: str
    name: str
    state: TokenState
    instance: str
    """Which instance of multi-instance activities it is, as in `OpenActivity`."""
    visit: int


class ScopeKind(StrEnum):
    """What has variables of its own, within a process."""

    CALLED_PROCESS = "calledProcess"
    SUBPROCESS = "subProcess"
    INSTANCE = "instance"
    """An instance of a loop."""
    ACTIVITY = "activity"
    """An activity or event with mapped inputs, or the body of a loop."""


@dataclass(frozen=True, slots=True)
class InnerScope:
    """Variables that only a part of a process sees; `outer` is None in the process itself."""

    scope: str
    outer: str | None
    kind: ScopeKind
    element: str
    name: str
    instance: str
    variables: Mapping[str, Any] = field(repr=False)


MAX_LISTED = 1000
"""Tokens, and inner scopes, that are listed."""


def tokens(machine: Machine) -> tuple[OpenToken, ...]:
    """Return the first tokens, in the order of their creation."""
    return tuple(
        OpenToken(
            str(token.id),
            machine.element(token),
            machine.node(token).name,
            token.state,
            ", ".join(_instances(machine, token)),
            token.visit,
        )
        for token in islice(machine.state.tokens.values(), MAX_LISTED)
    )


def inner_scopes(machine: Machine) -> tuple[InnerScope, ...]:
    """Return the first scopes within a process that have variables, or could have some."""
    return tuple(islice(_inner_scopes(machine), MAX_LISTED))


def _inner_scopes(machine: Machine) -> Iterator[InnerScope]:
    frames, root = machine.state.frames, machine.state.root
    for token in machine.state.tokens.values():
        place = machine.element(token), machine.node(token).name, ", ".join(_instances(machine, token))
        outer = str(token.body) if token.body is not None else _outer(root, token.frame)
        if token.local or token.body is not None:
            kind = ScopeKind.ACTIVITY if token.body is None else ScopeKind.INSTANCE
            yield InnerScope(str(token.id), outer, kind, *place, token.local)
            outer = str(token.id)
        if token.child is not None:
            frame = frames[token.child]
            kind = ScopeKind.SUBPROCESS if frame.process is None else ScopeKind.CALLED_PROCESS
            yield InnerScope(str(frame.id), outer, kind, *place, frame.variables)


def _outer(root: Frame, frame: int) -> str | None:
    return None if frame == root.id else str(frame)


def open_activity(machine: Machine, token: Token) -> OpenActivity:
    """Return the activity of a token that a performer works on."""
    node = machine.node(token)
    assert node.activity is not None  # noqa: S101 - only such a token works
    frame = machine.frame_of(token)
    data = {
        association.name or association.data: machine.data_owner(frame, association.data).get(
            association.data
        )
        for association in node.data_inputs
    }
    variables = machine.copy_variables(token)
    return OpenActivity(
        str(token.id),
        machine.element(token),
        token.visit,
        node.activity,
        variables,
        data,
        ", ".join(_instances(machine, token)),
    )


MAX_ITEM = 40
"""Characters of an item that describes an instance."""
_NAMES = ("name", "title", "label", "id", "key")
"""Entries by which an item that is an object is named."""


def _instances(machine: Machine, token: Token) -> list[str]:
    """Return which instances of multi-instance activities a token is in, the outermost first."""
    elements: list[str] = []
    inside: Token | None = token
    while inside is not None:
        body = None if inside.body is None else machine.state.tokens[inside.body]
        loop = machine.node(inside).loop
        if body is not None and body.loop is not None and isinstance(loop, MultiInstance):
            item = None if loop.item_variable is None else inside.local.get(loop.item_variable)
            described = _described(item)
            if (body.loop.total or 0) > 1:
                place = f"{inside.index + 1}/{body.loop.total}"
                elements.append(f"{place}: {described}" if described else place)
        inside = machine.host(machine.frame_of(inside))
    return elements[::-1]


def _described(item: Any) -> str:
    if isinstance(item, dict):
        item = next((item[name] for name in _NAMES if isinstance(item.get(name), str | int | float)), None)
    if item is None or not isinstance(item, str | int | float) or isinstance(item, bool):
        return ""
    text = " ".join(str(item).replace("\0", "").split())
    return text if len(text) <= MAX_ITEM else f"{text[: MAX_ITEM - 1]}…"


def incidents(machine: Machine, tokens: Iterable[int]) -> tuple[OpenIncident, ...]:
    """Return the incidents of `tokens`."""
    return tuple(
        OpenIncident(
            str(token.id),
            machine.element(token),
            machine.node(token).name,
            token.incident.reason,
            token.incident.since,
            token.incident.stage,
            token.incident.details,
            token.visit,
        )
        for token in map(machine.state.tokens.__getitem__, tokens)
        if token.incident is not None
    )


def subscriptions(machine: Machine, waits: Iterable[int]) -> tuple[Subscription, ...]:
    """Return those of `waits` that are for messages and signals."""
    return tuple(
        Subscription(
            wait.id,
            wait.type,
            wait.text or "",
            wait.key,
            machine.state.frames[wait.frame].prefix + wait.node,
            machine.business_key(machine.state.frames[wait.frame]),
        )
        for wait in map(machine.state.waits.__getitem__, waits)
        if wait.type in {WaitType.MESSAGE, WaitType.SIGNAL}
    )


def entity_waits(machine: Machine, waits: Iterable[int]) -> tuple[EntityWait, ...]:
    """Return those of `waits` that have a filter of entities."""
    scopes = []
    for wait in map(machine.state.waits.__getitem__, waits):
        on = entity_filter(event_of(machine, wait))
        if on is not None:
            element = machine.state.frames[wait.frame].prefix + wait.node
            scopes.append(
                EntityWait(wait.id, wait.type, wait.text or "", wait.key, on, element, tuple(wait.holding))
            )
    return tuple(scopes)
