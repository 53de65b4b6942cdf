"""State: tokens, frames and waits of one process, and their snapshot.

A frame is a running scope: the process itself, a subprocess, an event subprocess or a called process. Only
what is alive is part of the state, so that a step costs the same however long a process has run.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from datetime import datetime
from enum import StrEnum
from typing import Any, NamedTuple, Protocol, TypedDict, TypeVar

import orjson

from handover.errors import TranslatedError
from handover.messages import message, message_in, text_of, with_code
from handover_bpmn.execution.graph import Graph, Plan
from handover_bpmn.execution.tracked import Tracked

R = TypeVar("R")

SNAPSHOT_VERSION = 1
MAX_SNAPSHOT_BYTES = 4 * 1024 * 1024
"""Size of a snapshot; the variables are most of it."""


class RunFailed(TranslatedError):
    """The engine cannot do what is asked of it; the text names the element and the reason."""


class NotStorable(RunFailed):
    """The variables cannot be part of a snapshot: they are too large, or no JSON."""


class TokenState(StrEnum):
    """What a token does at its node."""

    READY = "ready"
    """It is about to enter the node."""
    WORK = "work"
    """A performer works on its Task."""
    WAITING = "waiting"
    """It waits for an event."""
    SCOPE = "scope"
    """A frame runs in its node."""
    LOOP = "loop"
    """It is the body of a loop; its inner tokens do the work."""
    JOINED = "joined"
    """It waits at a join for the other branches."""
    COMPENSATING = "compensating"
    """It waits for compensation handlers."""
    FINISHING = "finishing"
    """It is about to pass its results on and to leave the node."""
    LEAVING = "leaving"
    """Its results are passed on; it is about to leave the node."""
    INCIDENT = "incident"
    """It cannot continue until an engineer resolves its incident."""


@dataclass(slots=True)
class Incident:
    """Why a token cannot continue; `stage` is the state in which it stopped.

    A token that fails in `READY`, `WORK`, `FINISHING` or `LEAVING` stops: its state becomes `INCIDENT`. In
    any other stage it keeps its state, because what runs or waits in its node continues; one of its events
    or its join has failed.
    """

    stage: TokenState
    reason: str
    since: datetime
    details: dict[str, Any] = field(default_factory=dict)


@dataclass(slots=True)
class Loop:
    """Progress of a loop or of a multi-instance activity."""

    total: int | None
    """Number of instances; None for a standard loop."""
    started: int = 0
    completed: int = 0
    items: list[Any] | None = None
    outputs: list[Any] | None = None


class Content(TypedDict):
    """What a completed subprocess leaves behind for its compensation."""

    local: dict[str, Any]
    variables: dict[str, Any]
    data: dict[str, Any]
    completions: "list[Completion]"


class Completion(TypedDict, total=False):
    """A completed activity that can be compensated; `inside` if it is a subprocess without a handler."""

    activity: str
    local: dict[str, Any]
    """The local variables of an instance of a loop."""
    inside: Content


@dataclass(slots=True)
class Compensation:
    """What a token still has to compensate: frames and completed activities of them, the next one last."""

    entries: list[tuple[int, Completion]]


@dataclass(slots=True)
class Token:
    """A token; ids are never used twice within a process."""

    id: int
    frame: int
    node: str
    state: TokenState = TokenState.READY
    via: str | None = None
    """The sequence flow by which it came."""
    visit: int = 0
    """How often the activity of its node was started when its Task was created; 0: never."""
    local: dict[str, Any] = field(default_factory=dict)
    results: dict[str, Any] | None = None
    """The results of the activity or the payload of the event that it takes along when it leaves."""
    incident: Incident | None = None
    body: int | None = None
    """The token of the loop of which this one is an instance."""
    index: int = 0
    loop: Loop | None = None
    compensation: Compensation | None = None
    compensates: int | None = None
    """The token that waits until this one has compensated."""
    inside: Content | None = None
    waits: list[int] = field(default_factory=list)
    inner: dict[int, None] = field(default_factory=dict)
    """The instances of a loop, in their order."""
    child: int | None = None
    """The frame that runs in its node."""


@dataclass(slots=True)
class Frame:
    """A running scope; `host` is the token in whose node it runs, None for the process itself."""

    id: int
    scope: str
    host: int | None = None
    process: tuple[str, int] | None = None
    """Name and version of the definition, if the frame is a process."""
    key: str | None = None
    """The business key of a called process, if its call activity gives it one."""
    variables: dict[str, Any] = field(default_factory=dict)
    data: dict[str, Any] = field(default_factory=dict)
    """Data objects by id."""
    completions: list[Completion] = field(default_factory=list)
    """Completed activities that can be compensated, in the order of their completion."""
    waits: list[int] = field(default_factory=list)
    tokens: Tracked[Token] = field(default_factory=Tracked)
    graph: Graph = field(default=None, repr=False)  # type: ignore[assignment]  # set before the first use
    prefix: str = ""
    """Prefix of the ids of elements in a called process: the ids of the call activities."""


class WaitType(StrEnum):
    """What ends a wait."""

    TIMER = "timer"
    MESSAGE = "message"
    SIGNAL = "signal"
    CONDITION = "condition"


@dataclass(slots=True)
class Wait:
    """A wait for the event `node` of a frame.

    `token` is the token that the event continues or, for a boundary event, whose activity it is attached to;
    None for an event subprocess.
    """

    id: int
    type: WaitType
    frame: int
    node: str
    token: int | None = None
    due: datetime | None = None
    text: str | None = None
    """The text of a repeating timer, or the name of a message or signal."""
    count: int = 0
    """How often the repeating timer was due."""
    key: Any = None
    """The correlation key of a message."""
    holds: bool = False
    """Whether the condition was true when it was last evaluated."""
    holding: list[str] = field(default_factory=list)
    """The entities for which the condition was true when it was last evaluated."""
    stopped: dict[str, Any] | None = None
    """The payload of the event, if processing it has failed; the wait is inactive until a retry."""


@dataclass(slots=True)
class State:
    """The state of one process. The root is the first frame; a frame comes after that of its host."""

    next_id: int = 1
    frames: Tracked[Frame] = field(default_factory=Tracked)
    tokens: Tracked[Token] = field(default_factory=Tracked)
    waits: Tracked[Wait] = field(default_factory=Tracked)
    visits: dict[str, int] = field(default_factory=dict)
    completed: bool = False
    failure: str | None = None
    """Why the process has ended by an error that nothing caught."""
    conditions: dict[int, None] = field(default_factory=dict)
    """The waits for conditions."""
    _written: "_Written" = field(default_factory=lambda: _Written({}, {}, {}), repr=False, compare=False)

    def new_id(self) -> int:
        """Return an id that no token, frame or wait of this process ever had."""
        id_, self.next_id = self.next_id, self.next_id + 1
        return id_

    @property
    def root(self) -> Frame:
        """Return the frame of the process itself."""
        return self.frames[next(iter(self.frames))]

    def add_frame(self, frame: Frame) -> None:
        """Add a frame, which has no tokens yet."""
        frame.tokens = Tracked(self.tokens.touched)
        self.frames[frame.id] = frame

    def touch_all(self) -> None:
        """Note that every record may have changed."""
        for records in (self.frames, self.tokens, self.waits):
            records.touched.update(records)

    def add_wait(self, wait: Wait) -> None:
        """Add a wait to its token or frame."""
        self.waits[wait.id] = wait
        self._owner(wait).waits.append(wait.id)
        if wait.type is WaitType.CONDITION:
            self.conditions[wait.id] = None

    def remove_wait(self, wait: Wait) -> None:
        """Remove a wait from its token or frame."""
        del self.waits[wait.id]
        self._owner(wait).waits.remove(wait.id)
        self.conditions.pop(wait.id, None)

    def clear_waits(self, owner: Token | Frame) -> None:
        """Remove the waits of a token, or those of a frame for its event subprocesses."""
        for wait in owner.waits:
            del self.waits[wait]
            self.conditions.pop(wait, None)
        owner.waits.clear()

    def _owner(self, wait: Wait) -> Token | Frame:
        return self.frames[wait.frame] if wait.token is None else self.tokens[wait.token]

    def snapshot(self) -> bytes:
        """Return the serialized state; raise `NotStorable` if its variables are too large or no JSON."""
        rest = {
            "version": SNAPSHOT_VERSION,
            "next": self.next_id,
            "visits": self.visits,
            "completed": self.completed,
            **({} if self.failure is None else with_code("failure", self.failure)),
        }
        try:
            records = b",".join(
                (
                    _written(b"frames", self._written.frames, self.frames, _frame_values),
                    _written(b"tokens", self._written.tokens, self.tokens, _token_values),
                    _written(b"waits", self._written.waits, self.waits, _wait_values),
                )
            )
            written = b"%s,%s}" % (orjson.dumps(rest)[:-1], records)
        except TypeError as error:
            raise NotStorable(
                message(
                    "process.variable_not_json",
                    "a process variable is no JSON: {error}",
                    error=text_of(error),
                )
            ) from error
        if len(written) > MAX_SNAPSHOT_BYTES:
            raise NotStorable(
                message(
                    "process.variables_too_large",
                    "the variables and tokens of the process take more than {limit} bytes",
                    limit=MAX_SNAPSHOT_BYTES,
                )
            )
        return written


class _Written(NamedTuple):
    """The serialized records by id, as they were in the last snapshot."""

    frames: dict[int, bytes]
    tokens: dict[int, bytes]
    waits: dict[int, bytes]


def _written(
    name: bytes, written: dict[int, bytes], records: Tracked[R], values: Callable[[R], dict[str, Any]]
) -> bytes:
    """Serialize the records that were touched, and return a member of the snapshot with all of them."""
    for key in sorted(records.touched):
        record = records.peek(key)
        if record is None:
            written.pop(key, None)
        else:
            # orjson leaves its buffer of 4 kB with the bytes that it returns; a copy takes what it needs
            written[key] = bytes(memoryview(orjson.dumps(values(record))))
    records.touched.clear()
    return b'"%s":[%s]' % (name, b",".join(written.values()))


_DERIVED = frozenset({"tokens", "graph", "prefix", "waits", "inner", "child"})
_FRAME_FIELDS = tuple(field_.name for field_ in fields(Frame) if field_.name not in _DERIVED)
_WAIT_FIELDS = tuple(field_.name for field_ in fields(Wait))
_TOKEN_FIELDS = tuple(field_.name for field_ in fields(Token) if field_.name not in {*_DERIVED, "incident"})
_NULLABLE = frozenset({"key", "results", "stopped"})
"""Fields whose empty value is not the same as none."""


def _values(record: Any, names: Iterable[str]) -> dict[str, Any]:
    """Return the members of `record` that differ from their defaults, which are all false."""
    return {
        name: value
        for name in names
        if (value := getattr(record, name)) or (value is not None and name in _NULLABLE)
    }


def _frame_values(frame: Frame) -> dict[str, Any]:
    return _values(frame, _FRAME_FIELDS)


def _wait_values(wait: Wait) -> dict[str, Any]:
    return _values(wait, _WAIT_FIELDS)


def _token_values(token: Token) -> dict[str, Any]:
    values = _values(token, _TOKEN_FIELDS)
    if token.incident is not None:
        incident = token.incident
        values["incident"] = {
            "stage": incident.stage,
            "since": incident.since,
            "details": incident.details,
            **with_code("reason", incident.reason),
        }
    return values


class Library(Protocol):
    """The definitions that a process may call, by name and version."""

    def plan(self, name: str, version: int) -> Plan:
        """Return a version of a definition; raise `RunFailed` if there is none that can be executed."""

    def find(self, name: str, version: int | None, tag: str | None) -> Plan:
        """Return the latest version, or that with the version number or tag; raise `RunFailed` if none."""

    def deployed_at(self, name: str, version: int) -> datetime | None:  # noqa: ARG002
        """Return when a version was deployed, if that is known."""
        return None


def read_snapshot(snapshot: bytes, library: Library) -> State:
    """Return the state of a `snapshot`; raise `RunFailed` if this release cannot read it."""
    content = orjson.loads(snapshot)
    if content.get("version") != SNAPSHOT_VERSION:
        raise RunFailed.translated(
            "process.unknown_state_version",
            "this release cannot read a run of the format {version}",
            version=content.get("version"),
        )
    state = State(
        next_id=content["next"],
        visits=content["visits"],
        completed=content["completed"],
        failure=message_in(content, "failure"),
    )
    for values in content["frames"]:
        process = values.pop("process", None)
        frame = Frame(**values, process=None if process is None else (process[0], process[1]))
        state.add_frame(frame)
    for values in content["tokens"]:
        token = _read_token(values)
        state.tokens[token.id] = token
    for values in content["waits"]:
        wait = Wait(**{**values, "type": WaitType(values["type"])})
        wait.due = _moment(wait.due)
        state.add_wait(wait)
    _link(state, library)
    return state


def _read_token(values: dict[str, Any]) -> Token:
    incident, loop = values.pop("incident", None), values.pop("loop", None)
    compensation = values.pop("compensation", None)
    token = Token(**values)
    token.state = TokenState(token.state)
    if incident is not None:
        since = _moment(incident["since"])
        assert since is not None  # noqa: S101 - written by `_token_values`
        reason = message_in(incident, "reason") or ""
        token.incident = Incident(TokenState(incident["stage"]), reason, since, incident["details"])
    if loop is not None:
        token.loop = Loop(**loop)
    if compensation is not None:
        token.compensation = Compensation([(frame, entry) for frame, entry in compensation["entries"]])
    return token


def _link(state: State, library: Library) -> None:
    """Restore what is derived: graphs, prefixes and tokens of frames, inner tokens and frames of tokens."""
    for frame in state.frames.values():
        host = None if frame.host is None else state.tokens[frame.host]
        if frame.process is not None:
            frame.graph = library.plan(*frame.process).graph
        if host is not None:
            outer = state.frames[host.frame]
            if frame.process is None:
                frame.graph = outer.graph.inner[frame.scope]
            frame.prefix = prefix_within(outer, host, is_call=frame.process is not None)
            host.child = frame.id
    for token in state.tokens.values():
        state.frames[token.frame].tokens[token.id] = token
        if token.body is not None:
            state.tokens[token.body].inner[token.id] = None


def prefix_within(outer: Frame, host: Token, *, is_call: bool) -> str:
    """Return the prefix of the frame that runs in the node of `host`."""
    return f"{outer.prefix}{host.node}." if is_call else outer.prefix


def _moment(value: Any) -> datetime | None:
    return datetime.fromisoformat(value) if isinstance(value, str) else None
