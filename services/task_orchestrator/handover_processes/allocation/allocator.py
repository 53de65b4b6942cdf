"""Allocator: decides who performs an activity when its Task is posted.

`AssignmentRules` say what its performer needs. For a role or skills an agent is chosen. If none can take the
activity, or the named one is busy or reserved, it waits, and is tried again when agents, their Tasks or
reservations change. The allocator knows the open Tasks of each agent, and the waiting activities and the
reservations of all processes. The processes keep these up to date; nothing of this is stored here, since it
follows from them.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from operator import itemgetter
from typing import TypeAlias

from handover.messages import Message, message
from handover_bpmn.languages.base import ExpressionError, Variables
from handover_bpmn.model import Activity, Value
from handover_bpmn.spans import Need
from handover_processes.allocation.agents import UNLIMITED, Agent
from handover_processes.allocation.assignment import AssignmentRules, PerformerAssignment, named_request
from handover_processes.allocation.choice import (
    DEFAULT_PRIORITY,
    ChooseByRules,
    Chooser,
    Order,
    Request,
    WaitingRequest,
    joined,
    name_of,
    order_of,
    rank,
)
from handover_processes.allocation.hints import given_priority
from handover_processes.allocation.reservations import (
    Hold,
    Holder,
    Refused,
    Reservations,
    Situation,
    WaitingReservation,
    Wanted,
    held_by,
    wanted_by,
)
from handover_processes.deployed_forms import FormRegistry
from handover_processes.references import resource_id
from handover_processes.settings import OrchestratorSettings


@dataclass(frozen=True, slots=True)
class Within:
    """The reservations within which an activity is, the innermost first."""

    holders: tuple[Holder, ...] = ()
    spans: tuple[str, ...] = ()
    """The spans in which it is."""
    lanes: tuple[str, ...] = ()
    """Those of them that are lanes."""


OUTSIDE = Within()
Needs: TypeAlias = Mapping[str, Sequence[Need]]
"""What each span needs, the outermost first."""


@dataclass(frozen=True, slots=True)
class AskedReservation:
    """What is reserved for spans; those whom their `activities` name beside it are used."""

    holder: Holder
    needs: Needs
    activities: Iterable[Activity]
    variables: Variables
    since: datetime

    @property
    def order(self) -> Order:
        """Return the order in which it is served: by the highest priority of its activities."""
        rights: list[int] = []
        for activity in self.activities:
            with suppress(ExpressionError):  # a variable that an earlier activity of the span sets
                priority = given_priority(activity, self.variables)
                rights += [] if priority is None else [priority]
        priority = max(rights, default=DEFAULT_PRIORITY)
        return order_of(priority, None, self.since, self.holder)


@dataclass(frozen=True, slots=True)
class NoPerformer:
    """Nobody can take an activity now; `is_final` if all have declined it."""

    reason: Message
    request: Request
    is_final: bool = False


class Allocator:
    """The decisions of one orchestrator."""

    def __init__(self, settings: OrchestratorSettings, chooser: Chooser | None = None) -> None:
        self._settings = settings
        self._chooser: Chooser = chooser or ChooseByRules()
        self.rules = AssignmentRules(settings)
        self.forms = FormRegistry()
        self.has_changed = False
        """Whether waiting activities should be tried again: an agent or its Tasks have changed."""
        self._tasks: dict[str, str] = {}
        self._loads: dict[str, dict[str, None]] = {}
        self._waiting: dict[tuple[str, str], WaitingRequest] = {}
        self.reservations = Reservations()

    # Open Tasks and waiting activities

    def add_task(self, task_id: str, agent: str) -> None:
        """Count an open Task of an agent."""
        if task_id not in self._tasks:
            self._tasks[task_id] = agent
            self._loads.setdefault(agent, {})[task_id] = None

    def remove_task(self, task_id: str) -> None:
        """Handle that a Task has ended."""
        agent = self._tasks.pop(task_id, None)
        if agent is not None:
            tasks = self._loads[agent]
            del tasks[task_id]
            if not tasks:
                del self._loads[agent]
            self.has_changed = True

    def tasks_of(self, agent: str) -> list[str]:
        """Return the open Tasks of an agent."""
        return list(self._loads.get(agent, ()))

    def add_waiting(
        self,
        process: str,
        token: str,
        request: Request,
        since: datetime,
        within: tuple[Holder, ...] = (),
    ) -> None:
        """Let the activity of a token wait for an agent."""
        key = process, token
        self._waiting[key] = WaitingRequest(request, since, key, within)

    def remove_waiting(self, process: str, token: str) -> None:
        """Handle that an activity no longer waits."""
        if self._waiting.pop((process, token), None) is not None:
            self.has_changed = True

    @property
    def has_waiting(self) -> bool:
        """Return whether an activity or a reservation waits for an agent."""
        return bool(self._waiting or self.reservations.waiting)

    def waiting(self) -> Iterator[str]:
        """Yield the processes that may get an agent for which they wait, in the order of service.

        What those before have got is no longer offered: many may wait for one robot.
        """
        waiting: list[tuple[Order, str, Request | Wanted]] = [
            (waiting_activity.order, waiting_activity.key[0], waiting_activity.request)
            for waiting_activity in self._waiting.values()
        ]
        waiting += [
            (reservation.order, reservation.holder[0], reservation.wanted)
            for reservation in self.reservations.waiting.values()
        ]
        tried: set[str] = set()
        for _, process, needed in sorted(waiting, key=itemgetter(0)):
            if process not in tried and self._may_be_served(needed):
                tried.add(process)
                yield process

    def _may_be_served(self, needed: Request | Wanted) -> bool:
        """Return whether the agents are free; whether others come before is not looked at."""
        if isinstance(needed, Request):
            return needed.resource is None or self._load(needed.resource) < self._limit(needed.resource)
        if not all(map(self._is_idle, needed.named)):
            return False
        agents = self.rules.agents.by_id.values()
        return all(
            any(slot.suits(agent) and self._is_idle(agent.id) for agent in agents) for slot in needed.slots
        )

    def _is_idle(self, agent: str) -> bool:
        return agent not in self._loads and self.reservations.holding(agent) is None

    # Reservations

    def hold(self, hold: Hold) -> None:
        """Add a reservation that is held."""
        self.reservations.hold(hold)

    def release(self, holder: Holder) -> None:
        """Remove a reservation, whether it is held or waits."""
        if self.reservations.release(holder):
            self.has_changed = True

    def reserve(self, asked: AskedReservation, now: datetime) -> Hold | Message:
        """Reserve what spans need; else wait, and return the reason."""
        decision = self._decide(asked, now)
        if isinstance(decision, Hold):
            self.reservations.hold(decision)
            return decision
        return decision.reason

    def why_not_reserved(self, asked: AskedReservation, now: datetime) -> Message | None:
        """Return why a reservation has to wait; None if `reserve` would succeed."""
        decision = self._decide(asked, now)
        return None if isinstance(decision, Hold) else decision.reason

    def await_reservation(self, asked: AskedReservation, reason: str) -> None:
        """Let a reservation wait that has waited before a restart."""
        wanted = self._wanted(asked)
        self.reservations.waiting[asked.holder] = WaitingReservation(
            asked.holder, wanted, asked.order, reason, wanted.named
        )

    def cover(self, holder: Holder, needs: Needs) -> dict[str, tuple[str, ...]] | None:
        """Return what is reserved for spans that share a reservation; None if they need more than it has."""
        hold = self.reservations.held[holder]
        spans: dict[str, tuple[str, ...]] = {}
        for span, span_needs in needs.items():
            agents: list[str] = []
            for need in span_needs:
                wanted = self._claim(need)
                agent = next(
                    (a for a in sorted(hold.reserved) if a not in agents and self._meets(wanted, a)), None
                )
                if agent is None:
                    return None
                agents.append(agent)
            spans[span] = tuple(agents)
        self.share(holder, spans)
        return spans

    def share(self, holder: Holder, spans: Mapping[str, tuple[str, ...]]) -> None:
        """Let a reservation that is held serve the spans of a called process, too."""
        hold = self.reservations.held.get(holder)
        if hold is not None:
            self.reservations.held[holder] = replace(hold, spans={**hold.spans, **spans})

    def _decide(self, asked: AskedReservation, now: datetime) -> Hold | Refused:
        wanted = self._wanted(asked)
        situation = Situation(self.rules.agents.by_id, now, self.tasks_of, self._waits_before, self._rank)
        decision = self.reservations.decide(asked.holder, wanted, asked.order, situation)
        if isinstance(decision, Refused):
            self.reservations.waiting[asked.holder] = WaitingReservation(
                asked.holder, wanted, asked.order, decision.reason, decision.claimed
            )
        return decision

    def _rank(self, request: Request, agent: Agent) -> tuple[float | str, ...]:
        return rank(request, agent, self._load(agent.id))

    def _claim(self, need: Need) -> str | Request:
        if need.resource is None:
            return Request(need.role, need.skills)
        return resource_id(self._settings, need.resource)

    def _meets(self, claim: str | Request, agent: str) -> bool:
        return claim == agent if isinstance(claim, str) else self._suits(claim, agent)

    def waits_for(self, holder: Holder) -> str | None:
        """Return the present reason why a reservation waits."""
        waiting = self.reservations.waiting.get(holder)
        if waiting is None:
            return None
        wanted = waiting.wanted
        named = sorted(wanted.named)
        suitable = [a for a in self.rules.agents.by_id if any(self._suits(slot, a) for slot in wanted.slots)]
        holds = {agent: self.reservations.holding(agent) for agent in (*named, *suitable)}
        held = [held_by(agent, hold) for agent, hold in holds.items() if hold is not None]
        return joined(held) if held else waiting.reason

    def _wanted(self, asked: AskedReservation) -> Wanted:
        claims = {
            span: [self._claim(need) for need in span_needs] for span, span_needs in asked.needs.items()
        }
        named = {claim: span for span, them in claims.items() for claim in them if isinstance(claim, str)}
        spans = {
            span: [self._shared_name(claim, span, named) or claim for claim in them]
            for span, them in claims.items()
        }
        used: set[str] = set()
        used_slots: list[Request] = []
        for activity in asked.activities:
            with suppress(ExpressionError):  # it is not known yet who performs it
                assignment = self.rules.assign(activity, asked.variables)
                used |= set(self.rules.named(assignment.activity, asked.variables))
                request = assignment.request
                if request is not None and not any(self._suits(request, agent) for agent in named):
                    used_slots.append(request)
        return wanted_by(spans, used, used_slots)

    def _shared_name(self, claim: str | Request, span: str, named: Mapping[str, str]) -> str | None:
        """Return the agent that another span names and that has what `span` needs."""
        if isinstance(claim, str):
            return None
        return next((a for a, other in named.items() if other != span and self._suits(claim, a)), None)

    def _suits(self, request: Request, urn: str) -> bool:
        agent = self.rules.agents.by_id.get(urn)
        return agent is not None and request.suits(agent)

    def _load(self, agent: str) -> int:
        return len(self._loads.get(agent, ()))

    def _limit(self, agent: str) -> int:
        """Return how many Tasks that name an agent it gets at a time; one that is unknown gets all."""
        known_agent = self.rules.agents.by_id.get(agent)
        return UNLIMITED if known_agent is None else known_agent.limit

    def _waits_before(self, agent: str, order: Order) -> bool:
        """Return whether an activity waits for an agent before `order`, or within a reservation."""
        known_agent = self.rules.agents.by_id.get(agent)
        for candidate in self._waiting.values():
            is_before = bool(candidate.within) or candidate.order < order
            if is_before and (
                candidate.request.resource == agent or (known_agent and candidate.request.suits(known_agent))
            ):
                return True
        return False

    # Decisions

    def choose(
        self,
        assignment: PerformerAssignment,
        key: tuple[str, str],
        since: datetime,
        now: datetime,
        within: Within = OUTSIDE,
    ) -> PerformerAssignment | NoPerformer:
        """Return the assignment to an agent, or why the activity waits; `key` are process and token."""
        agent = self._reserved_for(assignment, within)
        if agent is not None:
            declined = assignment.request.declined if assignment.request is not None else frozenset()
            if agent in declined:
                return NoPerformer(_reserved_declined(agent), named_request(assignment, agent), is_final=True)
            reason = message("reservation.performs", "{agent}, reserved for it", agent=name_of(agent))
            activity = replace(assignment.activity, involves=(Value(agent),))
            assignment = replace(assignment, activity=activity, reason=reason, candidates=None)
            return self._choose_named(assignment, (agent,), key, since, within)
        if assignment.performers:
            return self._choose_named(assignment, assignment.performers, key, since, within)
        if assignment.request is None:
            return assignment
        mine = WaitingRequest(assignment.request, since, key, within.holders)
        return self._choose_agent(assignment, mine, now)

    def _reserved_for(self, assignment: PerformerAssignment, within: Within) -> str | None:
        """Return the reserved agent that performs an activity, by preference that of the innermost span."""
        held = self.reservations.held
        holds = [held[holder] for holder in within.holders if holder in held]
        spans = within.lanes if assignment.has_no_performer else within.spans
        agents = [agent for span in spans for hold in holds for agent in hold.spans.get(span, ())]
        if assignment.has_no_performer:
            return agents[0] if agents else None
        request = assignment.request
        if request is None:
            return None
        agents += [agent for hold in holds for them in hold.spans.values() for agent in them]
        suiting = replace(request, declined=frozenset())
        return next((agent for agent in agents if self._suits(suiting, agent)), None)

    def _choose_named(
        self,
        assignment: PerformerAssignment,
        performers: Sequence[str],
        key: tuple[str, str],
        since: datetime,
        within: Within,
    ) -> PerformerAssignment | NoPerformer:
        """Let named agents perform an activity if nobody else holds them and the first has capacity."""
        mine = WaitingRequest(named_request(assignment, performers[0]), since, key, within.holders)
        for agent in performers:
            why = self._reserved_by_others(agent, mine)
            if why is not None:
                return self._refused(agent, mine, why)
        first = performers[0]
        free = self._limit(first) - self._load(first)
        if free <= 0:
            busy = message("allocation.busy", "{agent} is busy", agent=name_of(first))
            return NoPerformer(busy, mine.request)
        named = self.rules.agents.by_id.get(first)
        if named is not None and free < UNLIMITED and len(self._before(mine, named)) >= free:
            why = message("allocation.others_first", "others wait for {agent} before", agent=name_of(first))
            return NoPerformer(why, mine.request)
        return assignment

    def _refused(self, agent: str, mine: WaitingRequest, why: Message) -> NoPerformer:
        """Return that an activity waits for a reserved agent; it is final if that would never end."""
        hold = self.reservations.holding(agent)
        if hold is None or not mine.within:
            return NoPerformer(why, mine.request)
        if self.reservations.leads_to(hold.holder, mine.within, self._waits_within()):
            circle = message(
                "reservation.circle",
                "{why}, which waits for this process; let {agent} be reserved with the others",
                why=why,
                agent=name_of(agent),
            )
            return NoPerformer(circle, mine.request, is_final=True)
        return NoPerformer(why, mine.request)

    def _waits_within(self) -> dict[Holder, set[str]]:
        """Return the agents for which activities within each reservation wait."""
        claimed: dict[Holder, set[str]] = {}
        for candidate in self._waiting.values():
            for holder in candidate.within:
                agents = {agent for agent in self.rules.agents.by_id if self._suits(candidate.request, agent)}
                if candidate.request.resource is not None:
                    agents.add(candidate.request.resource)
                claimed.setdefault(holder, set()).update(agents)
        return claimed

    def _reserved_by_others(self, agent: str, mine: WaitingRequest) -> Message | None:
        """Return why an agent is reserved, or about to be, so that an activity cannot have it."""
        hold = self.reservations.holding(agent)
        if hold is not None:
            return None if hold.holder in mine.within else held_by(agent, hold)
        if not mine.within and self.reservations.claims(agent, mine.order):
            return message("allocation.others_first", "others wait for {agent} before", agent=name_of(agent))
        return None

    def _before(self, mine: WaitingRequest, agent: Agent) -> list[WaitingRequest]:
        """Return the activities that get an agent before another one."""
        hold = self.reservations.holding(agent.id)
        return [
            candidate
            for candidate in self._waiting.values()
            if candidate.key != mine.key
            and candidate.precedence < mine.precedence
            and (hold is None or hold.holder in candidate.within)
            and candidate.request.suits(agent)
        ]

    def _choose_agent(
        self,
        assignment: PerformerAssignment,
        mine: WaitingRequest,
        now: datetime,
    ) -> PerformerAssignment | NoPerformer:
        request = mine.request
        agents = list(self.rules.agents.by_id.values())
        loads = {agent: list(tasks) for agent, tasks in self._loads.items()}
        blocked: dict[str, Message] = {}
        for agent in agents if self.reservations.held or self.reservations.waiting else ():
            why = self._reserved_by_others(agent.id, mine) if request.suits(agent) else None
            if why is not None:
                blocked[agent.id] = why
        chosen = self._chooser.choose(request, agents, loads, blocked, now)
        if chosen.agent is not None and self._waiting:
            best = self.rules.agents.by_id[chosen.agent]
            if self._before(mine, best):
                for agent in agents:
                    free = agent.capacity - self._load(agent.id)
                    if (
                        agent.id not in blocked
                        and request.suits(agent)
                        and len(self._before(mine, agent)) >= free
                    ):
                        name = agent.name
                        blocked[agent.id] = message(
                            "allocation.others_first", "others wait for {agent} before", agent=name
                        )
                chosen = self._chooser.choose(request, agents, loads, blocked, now)
        if chosen.agent is None:
            held = next((agent for agent in blocked if self.reservations.holding(agent)), None)
            if held is not None and not chosen.is_final:
                return replace(self._refused(held, mine, chosen.reason), request=request)
            return NoPerformer(chosen.reason, request, chosen.is_final)
        activity = replace(assignment.activity, involves=(Value(chosen.agent),))
        return replace(assignment, activity=activity, reason=chosen.reason)


def _reserved_declined(agent: str) -> Message:
    return message(
        "reservation.declined",
        "{agent}, which is reserved for it, declined; release the reservation to ask others",
        agent=name_of(agent),
    )
