"""Reservations: which process holds which agents, and which wait for them.

A reservation is acquired all at once: while it is held, its process acquires no other one for what it does
within. It *reserves* agents, which nobody else gets meanwhile, and *uses* those that its activities name
beside them: nobody else reserves these meanwhile, but other processes may use them, too. So an activity
within a reservation waits at most for a Task, and Tasks end. An agent that is used but was unknown at the
beginning is an exception; a wait for it that closes a circle is refused.

Those that wait have one order: priority, due date, since when, id. Who comes earlier keeps its place at each
agent that it waits for, so that everybody gets served; one that cannot be served even by idle agents does not
hold up others. Activities within a reservation come before all of them.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial

from handover.messages import Message, message
from handover_processes.allocation.agents import Agent
from handover_processes.allocation.choice import Order, Request, joined, name_of

Holder = tuple[str, str]
"""A process, and the key of its active span."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a reservation needs: `slots` are agents to be chosen, all different."""

    spans: Mapping[str, tuple[str | int, ...]] = field(default_factory=dict)
    """What each span reserves: agents by their URN, slots by their index."""
    slots: tuple[Request, ...] = ()
    used: frozenset[str] = frozenset()
    used_slots: tuple[Request, ...] = ()

    @property
    def named(self) -> frozenset[str]:
        """Return the agents that are reserved by their URN."""
        return frozenset(slot for span in self.spans.values() for slot in span if isinstance(slot, str))


def wanted_by(
    spans: Mapping[str, Sequence[str | Request]], used: Iterable[str], used_slots: Iterable[Request]
) -> Wanted:
    """Return what spans need together, the outermost first.

    Different needs of one span are different agents. A span within another one shares those of the outer.
    """
    slots: list[Request] = []
    taken: dict[str, list[str | int]] = {}
    for span, needs in spans.items():
        mine: list[str | int] = []
        for need in needs:
            mine.append(need if isinstance(need, str) else _slot(need, slots, mine))
        taken[span] = mine
    reserved = {need for needs in taken.values() for need in needs if isinstance(need, str)}
    return Wanted(
        {span: tuple(dict.fromkeys(needs)) for span, needs in taken.items()},
        tuple(slots),
        frozenset(used) - reserved,
        tuple(slot for slot in dict.fromkeys(used_slots)),
    )


def _slot(need: Request, slots: list[Request], taken: list[str | int]) -> int:
    for index, slot in enumerate(slots):
        if index in taken:
            continue
        if _implies(slot, need):
            return index
        if _implies(need, slot):
            slots[index] = need
            return index
    slots.append(need)
    return len(slots) - 1


def _implies(request: Request, other: Request) -> bool:
    """Return whether every agent that suits `one` suits `other`."""
    return other.role in {None, request.role} and set(other.skills) <= set(request.skills)


@dataclass(frozen=True, slots=True)
class Hold:
    """A reservation that is held."""

    holder: Holder
    spans: Mapping[str, tuple[str, ...]]
    """The reserved agents of each span."""
    used: frozenset[str]
    since: datetime
    reason: str = ""

    @property
    def reserved(self) -> frozenset[str]:
        """Return the reserved agents of all spans."""
        return frozenset(agent for agents in self.spans.values() for agent in agents)


@dataclass(frozen=True, slots=True)
class WaitingReservation:
    """A reservation that waits, and the agents at which it keeps its place."""

    holder: Holder
    wanted: Wanted
    order: Order
    reason: str
    claimed: frozenset[str]


@dataclass(frozen=True, slots=True)
class Refused:
    """Why a reservation has to wait, and the agents at which it keeps its place."""

    reason: Message
    claimed: frozenset[str]


@dataclass(frozen=True, slots=True)
class Situation:
    """What a decision about a reservation depends on beside the other ones."""

    agents: Mapping[str, Agent]
    now: datetime
    tasks_of: Callable[[str], Sequence[str]]
    waits_before: Callable[[str, Order], bool]
    """Whether an activity that comes before, or one within a reservation, waits for an agent."""
    rank: Callable[[Request, Agent], tuple[float | str, ...]]


class Reservations:
    """All reservations that are held or waited for."""

    def __init__(self) -> None:
        self.held: dict[Holder, Hold] = {}
        self.waiting: dict[Holder, WaitingReservation] = {}
        self._by_agent: dict[str, Holder] = {}
        self._users: dict[str, dict[Holder, None]] = {}

    def hold(self, hold: Hold) -> None:
        """Add a reservation that is held."""
        self.waiting.pop(hold.holder, None)
        self.held[hold.holder] = hold
        for agent in hold.reserved:
            self._by_agent[agent] = hold.holder
        for agent in hold.used:
            self._users.setdefault(agent, {})[hold.holder] = None

    def release(self, holder: Holder) -> frozenset[str]:
        """Remove a reservation, whether it is held or waits; return the agents that others may get now."""
        waiting, hold = self.waiting.pop(holder, None), self.held.pop(holder, None)
        freed = waiting.claimed if waiting is not None else frozenset()
        if hold is None:
            return freed
        for agent in hold.reserved:
            if self._by_agent.get(agent) == holder:
                del self._by_agent[agent]
        for agent in hold.used:
            users = self._users[agent]
            del users[holder]
            if not users:
                del self._users[agent]
        return freed | hold.reserved | hold.used

    def holding(self, agent: str) -> Hold | None:
        """Return the reservation of an agent."""
        holder = self._by_agent.get(agent)
        return None if holder is None else self.held[holder]

    def claims(self, agent: str, order: Order) -> bool:
        """Return whether a waiting reservation that comes before `order` keeps its place at an agent."""
        return any(agent in wanted.claimed and wanted.order < order for wanted in self.waiting.values())

    def leads_to(self, start: Holder, targets: Iterable[Holder], waits: Mapping[Holder, set[str]]) -> bool:
        """Return whether `start` waits for one of `targets`, directly or by others.

        `waits` are the agents for which activities within reservations wait.
        """
        wanted, seen, stack = set(targets), set[Holder](), [start]
        while stack:
            holder = stack.pop()
            if holder in wanted:
                return True
            if holder in seen:
                continue
            seen.add(holder)
            stack += [self._by_agent[agent] for agent in waits.get(holder, ()) if agent in self._by_agent]
        return False

    # Decisions

    def decide(self, holder: Holder, wanted: Wanted, order: Order, situation: Situation) -> Hold | Refused:
        """Return the reservation if everything that it needs is free; nothing is changed."""
        attainable = self._match(wanted, situation, _no_obstacle)
        obstacles: dict[str, Message] = {}

        def obstacle(agent: str) -> Message | None:
            why = self._obstacle(agent, holder, order, situation)
            if why is not None:
                obstacles[agent] = why
            return why

        blocked = [why for agent in sorted(wanted.named) if (why := obstacle(agent)) is not None]
        matches = self._match(wanted, situation, obstacle)
        if matches is None:
            suitable = [a for slot in wanted.slots for a in _suitable(slot, situation)]
            blocked += [obstacles[a.id] for a in suitable if a.id in obstacles]
            blocked = blocked or [_unattainable(wanted, situation)]
        used, whys = self._used(wanted, holder, order, situation, matches or ())
        blocked += whys
        if blocked or matches is None:
            claimed = frozenset() if attainable is None else wanted.named | {*attainable}
            return Refused(joined(list(dict.fromkeys(blocked))), claimed)
        spans = {
            span: tuple(need if isinstance(need, str) else matches[need] for need in needs)
            for span, needs in wanted.spans.items()
        }
        reserved = frozenset(agent for agents in spans.values() for agent in agents)
        names = ", ".join(name_of(agent) for agent in sorted(reserved))
        reason = message("reservation.acquired", "{agents} reserved", agents=names)
        return Hold(holder, spans, used - reserved, situation.now, reason)

    def _obstacle(self, agent: str, holder: Holder, order: Order, situation: Situation) -> Message | None:
        """Return why an agent cannot be reserved now."""
        others = [user for user in self._users.get(agent, ()) if user != holder]
        hold = self.holding(agent)
        if hold is None and others:
            hold = self.held[others[0]]
        if hold is not None and hold.holder != holder:
            return held_by(agent, hold)
        tasks = situation.tasks_of(agent)
        if tasks:
            return message(
                "reservation.works",
                "{agent} still works on {task}",
                agent=name_of(agent),
                task=tasks[0].rpartition(":")[2],
            )
        if situation.waits_before(agent, order) or self._waits_before(agent, order):
            return message("allocation.others_first", "others wait for {agent} before", agent=name_of(agent))
        return None

    def _waits_before(self, agent: str, order: Order) -> bool:
        return any(
            wanted_.order < order
            and (agent in wanted_.claimed or (wanted_.claimed and agent in wanted_.wanted.used))
            for wanted_ in self.waiting.values()
        )

    def _used(
        self,
        wanted: Wanted,
        holder: Holder,
        order: Order,
        situation: Situation,
        chosen: Sequence[str],
    ) -> tuple[frozenset[str], list[Message]]:
        """Return the agents that are used, and why some of them cannot be."""
        used, blocked = set(wanted.used), []
        for agent in sorted(wanted.used):
            why = self._obstacle_of_use(agent, holder, order)
            if why is not None:
                blocked.append(why)
        mine = wanted.named | {*chosen}
        for request in wanted.used_slots:
            suitable = _suitable(request, situation)
            if not suitable or any(agent.id in mine for agent in suitable):
                continue
            whys = {agent.id: self._obstacle_of_use(agent.id, holder, order) for agent in suitable}
            free = [agent for agent in suitable if whys[agent.id] is None]
            if free:
                used.add(min(free, key=lambda agent: situation.rank(request, agent)).id)
            else:
                blocked += [why for why in whys.values() if why is not None]
        return frozenset(used), blocked

    def _obstacle_of_use(self, agent: str, holder: Holder, order: Order) -> Message | None:
        hold = self.holding(agent)
        if hold is not None and hold.holder != holder:
            return held_by(agent, hold)
        if self.claims(agent, order):
            return message("allocation.others_first", "others wait for {agent} before", agent=name_of(agent))
        return None

    def _preference(
        self, slot: Request, situation: Situation, agent: Agent
    ) -> tuple[bool, tuple[float | str, ...]]:
        return self.holding(agent.id) is not None, situation.rank(slot, agent)

    def _match(
        self, wanted: Wanted, situation: Situation, obstacle: Callable[[str], Message | None]
    ) -> tuple[str, ...] | None:
        """Return an agent for each slot, all different (augmenting paths); None if there are not enough."""
        named = wanted.named
        candidates = []
        for slot in wanted.slots:
            suitable = [
                agent
                for agent in _suitable(slot, situation)
                if agent.id not in named
                and agent.unavailable is None
                and agent.works_at(situation.now)
                and obstacle(agent.id) is None
            ]
            suitable.sort(key=partial(self._preference, slot, situation))
            candidates.append([agent.id for agent in suitable])
        slot_of: dict[str, int] = {}

        def place(slot: int, tried: set[str]) -> bool:
            for agent in candidates[slot]:
                if agent in tried:
                    continue
                tried.add(agent)
                if agent not in slot_of or place(slot_of[agent], tried):
                    slot_of[agent] = slot
                    return True
            return False

        if not all(place(slot, set()) for slot in range(len(candidates))):
            return None
        agents = {slot: agent for agent, slot in slot_of.items()}
        return tuple(agents[slot] for slot in range(len(candidates)))


def held_by(agent: str, hold: Hold) -> Message:
    """Return that an agent is held."""
    return message(
        "reservation.held",
        "{agent} is held by {process} since {since}",
        agent=name_of(agent),
        process=hold.holder[0],
        since=hold.since.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
    )


def _no_obstacle(_agent: str) -> Message | None:
    return None


def _suitable(request: Request, situation: Situation) -> list[Agent]:
    return [agent for agent in situation.agents.values() if request.suits(agent)]


def _unattainable(wanted: Wanted, situation: Situation) -> Message:
    missing = [slot for slot in wanted.slots if not list(_available(slot, situation))] or wanted.slots
    return message(
        "reservation.not_enough",
        "nobody available has {needed}",
        needed=", ".join(slot.described for slot in missing),
    )


def _available(slot: Request, situation: Situation) -> Iterator[Agent]:
    for agent in _suitable(slot, situation):
        if agent.unavailable is None and agent.works_at(situation.now):
            yield agent
