"""State index: what callers ask about all tokens and waits of a process.

`update` reads the records that were touched since the last snapshot, so a step of a process with 10,000 open
activities costs about the same as one of a process with ten.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime

from handover_bpmn.execution.state import State, Token, TokenState, Wait, WaitType
from handover_bpmn.timing.due_queue import DueQueue


@dataclass(frozen=True, slots=True)
class WorkChanges:
    """The activities that were opened and left since the last call, as token and visit."""

    opened: tuple[tuple[str, int], ...]
    left: tuple[tuple[str, int], ...]


@dataclass(slots=True)
class _Places:
    """How many records are at each element, in the order in which the elements were reached."""

    _element_of: dict[int, str] = field(default_factory=dict)
    _counts: dict[str, int] = field(default_factory=dict)

    def __iter__(self) -> Iterator[str]:
        return iter(self._counts)

    def set(self, record: int, element: str | None) -> None:
        """Set the element of a record; None if it is gone."""
        before = self._element_of.get(record)
        if before == element:
            return
        if before is not None:
            del self._element_of[record]
            self._counts[before] -= 1
            if not self._counts[before]:
                del self._counts[before]
        if element is not None:
            self._element_of[record] = element
            self._counts[element] = self._counts.get(element, 0) + 1


class StateIndex:
    """The index of one state."""

    __slots__ = (
        "_dues",
        "_left",
        "_opened",
        "_state",
        "_token_places",
        "_wait_places",
        "incidents",
        "subscribed",
        "working",
    )

    def __init__(self, state: State) -> None:
        self._state = state
        self.working: dict[int, int] = {}
        """The visit of each token whose activity is open."""
        self.incidents: dict[int, None] = {}
        """The tokens with an incident."""
        self.subscribed: dict[int, None] = {}
        """The waits for messages, signals and conditions."""
        self._token_places = _Places()
        self._wait_places = _Places()
        self._dues = DueQueue[int]()
        self._opened: dict[int, None] = {}
        self._left: list[tuple[str, int]] = []

    def update(self) -> None:
        """Read the records that the step has touched; the snapshot that follows clears the notes of them."""
        for token_id in sorted(self._state.tokens.touched):
            self._update_token(token_id, self._state.tokens.peek(token_id))
        for wait_id in sorted(self._state.waits.touched):
            self._update_wait(wait_id, self._state.waits.peek(wait_id))

    def replace(self, before: "StateIndex") -> None:
        """Take the place of the index of a state that was discarded."""
        self.update()
        gone = [(str(token), visit) for token, visit in before.working.items() if token not in self.working]
        self._left = [*before._left, *gone]

    def waiting(self) -> tuple[str, ...]:
        """Return the ids of the elements at which tokens are, and of the events that are waited for."""
        return tuple(dict.fromkeys((*self._token_places, *self._wait_places)))

    def next_due(self) -> datetime | None:
        """Return when the next timer is due."""
        return self._dues.next_due()

    def first_due(self, now: datetime) -> int | None:
        """Return the wait of the first timer that is due at `now`."""
        return self._dues.first_due(now)

    def take_work_changes(self) -> WorkChanges:
        """Return what has changed since the last call."""
        opened = tuple((str(token), self.working[token]) for token in self._opened if token in self.working)
        changes = WorkChanges(opened, tuple(self._left))
        self._opened, self._left = {}, []
        return changes

    def _update_token(self, token_id: int, token: Token | None) -> None:
        self._token_places.set(token_id, None if token is None else self._element(token))
        if token is None or token.incident is None:
            self.incidents.pop(token_id, None)
        else:
            self.incidents[token_id] = None
        before = self.working.get(token_id)
        visit = token.visit if token is not None and token.state is TokenState.WORK else None
        if before == visit:
            return
        if before is not None:
            del self.working[token_id]
            self._left.append((str(token_id), before))
        if visit is not None:
            self.working[token_id] = visit
            self._opened[token_id] = None

    def _update_wait(self, wait_id: int, wait: Wait | None) -> None:
        self._wait_places.set(wait_id, None if wait is None else self._element(wait))
        is_active = wait is not None and wait.stopped is None
        self._dues.set(wait_id, wait.due if wait is not None and is_active else None)
        if wait is not None and is_active and wait.type is not WaitType.TIMER:
            self.subscribed[wait_id] = None
        else:
            self.subscribed.pop(wait_id, None)

    def _element(self, record: Token | Wait) -> str:
        frame = self._state.frames.peek(record.frame)
        assert frame is not None  # noqa: S101 - a token or wait has a frame
        return frame.prefix + record.node
