"""Span reservations: the reservations of one process follow its tokens.

A reservation begins when a token enters a span, and ends when none is left in it. An activity within waits
until it is held. What is already reserved by a calling process is not reserved again; what is not would be
a second reservation while the first is held, and is refused.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime

from handover.errors import Problem
from handover.messages import message, text_of
from handover_bpmn.execution.run import Run
from handover_bpmn.execution.span_places import ActiveSpan, SpanPlace
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.spans import Need, evaluated_needs
from handover_processes.allocation.allocator import Allocator, AskedReservation, Within
from handover_processes.allocation.reservations import Hold
from handover_processes.records.processes import ReservationRecord, ReservationState

MAX_ENDED = 50
"""Ended reservations that a process keeps for its history."""

Records = tuple[ReservationRecord, ...]
_LIVE = frozenset(ReservationState) - {ReservationState.ENDED}
_ASKS_AGAIN = frozenset({ReservationState.IMPOSSIBLE, ReservationState.RELEASED})
"""States that end when an activity within needs a performer."""


@dataclass(slots=True)
class SpanReservations:
    """The reservations of one process; `records` are stored with it."""

    process: str
    allocator: Allocator
    records: Records = ()
    _registered: set[str] = field(default_factory=set)
    """The keys of those that the allocator knows."""

    @property
    def live(self) -> dict[str, ReservationRecord]:
        """Return those that have not ended, by key."""
        return {record.key: record for record in self.records if record.state in _LIVE}

    def resume(self, run: Run | None) -> None:
        """Bring the stored reservations into the allocator."""
        for record in self.live.values():
            if record.state is ReservationState.HELD:
                self._register(record)
        for span in run.active_spans() if run is not None else ():
            present = self.live.get(span.key)
            if run is not None and present is not None and present.state is ReservationState.WAITING:
                self._await(run, span, present)

    def leave(self) -> None:
        """Remove all from the allocator: the process leaves the memory."""
        for key in self._registered:
            self.allocator.release((self.process, key))
        self._registered.clear()

    def pause(self) -> None:
        """Let those that wait give up their place until the process is resumed."""
        for record in self.live.values():
            if record.state is ReservationState.WAITING:
                self._unregister(record.key)

    def update(self, run: Run | None, open_tokens: Iterable[str], now: datetime, *, reserves: bool) -> None:
        """End and begin reservations as the tokens are; `open_tokens` need a performer.

        Without `reserves` (the process is paused) none begins.
        """
        if not self.records and (run is None or not run.has_spans):
            return
        active = {span.key: span for span in run.active_spans()} if run is not None else {}
        for key, record in self.live.items():
            if key not in active:
                self._unregister(key)
                self._record(replace(record, state=ReservationState.ENDED, since=now))
        if run is None or not reserves:
            return
        asked = {place.key for token in open_tokens for place in run.places(token) if place.is_member}
        for span in active.values():
            present = self.live.get(span.key)
            if present is None:
                if span.is_entered:
                    self._reserve(run, span, None, now)
            elif present.state is ReservationState.WAITING or (
                present.state in _ASKS_AGAIN and span.key in asked
            ):
                self._reserve(run, span, present, now)

    def can_begin(self, run: Run, now: datetime) -> bool:
        """Return whether one of those that wait can begin now, or cannot be had any more."""
        waiting = {key for key, record in self.live.items() if record.state is ReservationState.WAITING}
        if not waiting:
            return False
        for span in run.active_spans():
            if span.key in waiting:
                try:
                    asked_at = self.live[span.key].asked_at
                    asked = self._asked(run, span, self._needs(run, span), asked_at)
                    if not span.outer and self.allocator.why_not_reserved(asked, now) is None:
                        return True
                except (ExpressionError, ValueError):
                    return True
        return False

    def within(self, places: Sequence[SpanPlace]) -> Within:
        """Return the held reservations within which an activity is."""
        live = self.live
        held = {place.key: live[place.key] for place in places if self._is_held(live.get(place.key))}
        return Within(
            tuple(dict.fromkeys((self.process, record.outer or key) for key, record in held.items())),
            tuple(span for place in places if place.key in held for span in place.spans),
            tuple(span for place in places if place.key in held for span in place.lanes),
        )

    def obstacle(self, places: Sequence[SpanPlace]) -> ReservationRecord | None:
        """Return the reservation that an activity has to wait for, or that is impossible."""
        live = self.live
        for place in places:
            record = live.get(place.key)
            if place.is_member and record is not None and record.state is not ReservationState.HELD:
                return record
        return None

    def release(self, key: str, now: datetime, by: str) -> ReservationRecord:
        """Release a reservation that is held; raise `Problem` 404 or 409 if there is none."""
        record = next((candidate for candidate in reversed(self.records) if candidate.key == key), None)
        if record is None:
            raise Problem.translated(
                404,
                "No such reservation",
                "reservation.unknown",
                '{process} has no reservation "{key}"',
                process=self.process,
                key=key,
            )
        if record.state is not ReservationState.HELD or record.outer is not None:
            raise Problem.translated(
                409,
                "Not held",
                "reservation.not_held",
                '"{name}" holds nothing that could be released',
                name=record.name,
            )
        self._unregister(key)
        reason = message("reservation.released", "released by {by}", by=by)
        released = replace(
            record, state=ReservationState.RELEASED, since=now, reason=reason, spans={}, used=()
        )
        self._record(released)
        for inner in [record for record in self.live.values() if record.outer == key]:
            self._record(
                replace(inner, state=ReservationState.RELEASED, since=now, reason=reason, outer=None)
            )
        return record

    # One reservation

    def _reserve(self, run: Run, span: ActiveSpan, present: ReservationRecord | None, now: datetime) -> None:
        asks_again = present is not None and present.state in _ASKS_AGAIN
        asked_at = now if present is None or asks_again else present.asked_at
        record = ReservationRecord(
            span.key, span.element, span.union.spans[0].name, ReservationState.WAITING, asked_at, asked_at, ""
        )
        try:
            needs = self._needs(run, span)
            if span.outer:
                self._record(self._covered(span, needs, record, now))
                return
            decision = self.allocator.reserve(self._asked(run, span, needs, asked_at), now)
        except (ExpressionError, ValueError) as error:
            self._unregister(span.key)
            self._record(replace(record, state=ReservationState.IMPOSSIBLE, since=now, reason=text_of(error)))
            return
        self._registered.add(span.key)
        if isinstance(decision, Hold):
            self._record(
                replace(
                    record,
                    state=ReservationState.HELD,
                    since=now,
                    held_at=now,
                    reason=decision.reason,
                    spans=decision.spans,
                    used=tuple(sorted(decision.used)),
                )
            )
        elif present is None or present.state is not ReservationState.WAITING:
            self._record(replace(record, reason=decision))

    def _asked(
        self, run: Run, span: ActiveSpan, needs: Mapping[str, Sequence[Need]], asked_at: datetime
    ) -> AskedReservation:
        variables = run.span_variables(span.key)
        return AskedReservation((self.process, span.key), needs, span.union.activities, variables, asked_at)

    def _needs(self, run: Run, span: ActiveSpan) -> dict[str, tuple[Need, ...]]:
        variables = run.span_variables(span.key)
        return {need_span.id: evaluated_needs(need_span, variables) for need_span in span.union.spans}

    def _covered(
        self, span: ActiveSpan, needs: Mapping[str, Sequence[Need]], record: ReservationRecord, now: datetime
    ) -> ReservationRecord:
        """Return a reservation within one of a calling process: it shares what that one has reserved.

        Raises `ValueError` if it needs more.
        """
        live = self.live
        outer = live.get(span.outer[-1])
        if outer is None or outer.state is not ReservationState.HELD:
            return record
        spans = self.allocator.cover((self.process, outer.outer or outer.key), needs)
        if spans is None:
            raise ValueError(
                message(
                    "reservation.not_covered",
                    '"{name}" needs more than "{outer}" has reserved, within which it is called; '
                    "let {outer} reserve it",
                    name=record.name,
                    outer=outer.name,
                )
            )
        return replace(
            record,
            state=ReservationState.HELD,
            since=now,
            held_at=now,
            reason=message("reservation.shared", 'shared with "{outer}"', outer=outer.name),
            spans=spans,
            outer=outer.outer or outer.key,
        )

    def _await(self, run: Run, span: ActiveSpan, record: ReservationRecord) -> None:
        try:
            needs = self._needs(run, span)
        except (ExpressionError, ValueError):
            return  # it becomes an incident when it is tried again
        if not span.outer:
            asked = self._asked(run, span, needs, record.asked_at)
            self.allocator.await_reservation(asked, record.reason)
            self._registered.add(span.key)

    def _register(self, record: ReservationRecord) -> None:
        if record.outer is None:
            held_at = record.held_at or record.since
            self.allocator.hold(
                Hold((self.process, record.key), record.spans, frozenset(record.used), held_at)
            )
            self._registered.add(record.key)
        else:
            self.allocator.share((self.process, record.outer), record.spans)

    def _unregister(self, key: str) -> None:
        if key in self._registered:
            self._registered.discard(key)
            self.allocator.release((self.process, key))

    def _record(self, changed: ReservationRecord) -> None:
        others = [
            record
            for record in self.records
            if record.key != changed.key or record.state is ReservationState.ENDED
        ]
        ended = [record for record in others if record.state is ReservationState.ENDED]
        dropped = set(map(id, ended[: max(0, len(ended) - MAX_ENDED)]))
        self.records = (*(record for record in others if id(record) not in dropped), changed)

    def _is_held(self, record: ReservationRecord | None) -> bool:
        return record is not None and record.state is ReservationState.HELD
