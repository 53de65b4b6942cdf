"""Choice: which of the agents performs an activity, by rules. A planner may take its place.

An agent is suitable if it has the role and skills, has not declined, and is allowed. Of the suitable agents
that are available (online, on shift, below their capacity) the one with the least load gets the activity;
then the higher skill level, the shorter distance, the lower cost and the higher speed decide, and last the
id. Of several activities that wait for the same agent the one with the higher priority gets it, then the one
with the earlier due date, then the one that waits longer.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Protocol, TypeAlias

from handover.messages import Message, message
from handover_processes.allocation.agents import Agent, Position

DEFAULT_PRIORITY = 50
MAX_OTHERS = 3
"""Other agents that a reason names."""

Order: TypeAlias = tuple[int, datetime, datetime, tuple[str, str]]
"""The order in which those that wait are served; the last part is a process, and a token or span of it."""

_NEVER = datetime.max.replace(tzinfo=UTC)


def order_of(priority: int, due: datetime | None, since: datetime, key: tuple[str, str]) -> Order:
    """Return the order of something that waits `since`."""
    return -priority, due or _NEVER, since, key


@dataclass(frozen=True, slots=True)
class Request:
    """What an activity needs of its performer."""

    role: str | None = None
    skills: tuple[str, ...] = ()
    place: Position | None = None
    priority: int = DEFAULT_PRIORITY
    due: datetime | None = None
    declined: frozenset[str] = frozenset()
    """The agents that have declined it."""
    people_only: bool = False
    resource: str | None = None
    """The URN of the only one that can do it."""

    def suits(self, agent: Agent) -> bool:
        """Return whether the agent can and may do it, now or later."""
        if self.resource is not None:
            return agent.id == self.resource
        if self.people_only and not agent.is_person:
            return False
        if agent.id in self.declined or (self.role is not None and self.role not in agent.roles):
            return False
        return all(skill in agent.skills for skill in self.skills)

    @property
    def described(self) -> str:
        """Return role and skills, or the resource, as text."""
        if self.resource is not None:
            return self.resource
        role = [] if self.role is None else [f"role:{self.role}"]
        return " ".join([*role, *(f"skill:{skill}" for skill in self.skills)])


@dataclass(frozen=True, slots=True)
class WaitingRequest:
    """A request that nobody could take yet."""

    request: Request
    since: datetime
    key: tuple[str, str]
    """The process and the token."""
    within: tuple[tuple[str, str], ...] = ()
    """The reservations within which it is."""

    @property
    def order(self) -> Order:
        """Return the order in which waiting requests are served."""
        return order_of(self.request.priority, self.request.due, self.since, self.key)

    @property
    def precedence(self) -> tuple[bool, Order]:
        """Return its order; those within a reservation come before all others."""
        return not self.within, self.order


@dataclass(frozen=True, slots=True)
class Choice:
    """The agent that gets an activity, or None, and why."""

    agent: str | None
    reason: Message
    is_final: bool = False
    """Whether all suitable agents have declined, so that waiting is useless."""


class Chooser(Protocol):
    """Chooses the agent for an activity."""

    def choose(
        self,
        request: Request,
        agents: Sequence[Agent],
        loads: Mapping[str, Sequence[str]],
        blocked: Mapping[str, Message],
        now: datetime,
    ) -> Choice:
        """Return the choice; `loads` are the open Tasks by agent.

        `blocked` are the agents that are reserved or for others, with the reason.
        """
        ...


class ChooseByRules:
    """The rules of this module."""

    def choose(
        self,
        request: Request,
        agents: Sequence[Agent],
        loads: Mapping[str, Sequence[str]],
        blocked: Mapping[str, Message],
        now: datetime,
    ) -> Choice:
        """Return the choice by the rules."""
        suitable = [agent for agent in agents if request.suits(agent)]
        if not suitable:
            return _nobody(request, are_known=bool(agents))
        available, others = [], []
        for agent in suitable:
            why_not = _obstacle(agent, loads.get(agent.id, ()), now) or blocked.get(agent.id)
            if why_not is None:
                available.append(agent)
            else:
                others.append(why_not)
        if not available:
            return Choice(None, joined(sorted(others)))
        best = min(available, key=lambda agent: rank(request, agent, len(loads.get(agent.id, ()))))
        chosen = _qualities(request, best, len(loads.get(best.id, ())))
        others += [
            message("allocation.also_free", "{agent} free as well", agent=agent.name)
            for agent in available
            if agent is not best
        ]
        return Choice(best.id, joined([chosen, *sorted(others)]))


def _obstacle(agent: Agent, tasks: Sequence[str], now: datetime) -> Message | None:
    """Return why an agent cannot take an activity now; None if it can."""
    if agent.unavailable is not None:
        return message(
            "allocation.unavailable", "{agent} is {state}", agent=agent.name, state=agent.unavailable
        )
    if not agent.works_at(now):
        return message("allocation.off_shift", "{agent} is off shift", agent=agent.name)
    if len(tasks) >= agent.capacity:
        if not tasks:
            return message("allocation.no_capacity", "{agent} has no capacity", agent=agent.name)
        return message("allocation.busy", "{agent} is busy", agent=agent.name)
    return None


def rank(request: Request, agent: Agent, load: int) -> tuple[float | str, ...]:
    """Return the order of agents that suit a request; the first is the best."""
    skills = [agent.skills[name] for name in request.skills]
    distance = _distance_m(request, agent)
    return (
        load / agent.capacity,
        -min((skill.level for skill in skills), default=0.0),
        float("inf") if distance is None else distance,
        sum(skill.cost for skill in skills),
        -min((skill.speed for skill in skills), default=0.0),
        agent.id,
    )


def _distance_m(request: Request, agent: Agent) -> float | None:
    if request.place is None or agent.position is None:
        return None
    return agent.position.distance_m(request.place)


def _qualities(request: Request, agent: Agent, load: int) -> Message:
    if load:
        reason = message(
            "allocation.loaded",
            "{agent}: {load} of {capacity} Tasks",
            agent=agent.name,
            load=load,
            capacity=agent.capacity,
        )
    else:
        reason = message("allocation.idle", "{agent}: idle", agent=agent.name)
    if request.skills:
        level = min(agent.skills[name].level for name in request.skills)
        reason = message("allocation.with_skill", "{agent}, skill {level}", agent=reason, level=f"{level:g}")
    distance = _distance_m(request, agent)
    if distance is not None:
        reason = message(
            "allocation.at", "{agent}, {distance} m away", agent=reason, distance=f"{distance:.3g}"
        )
    return reason


def _nobody(request: Request, *, are_known: bool) -> Choice:
    if request.declined:
        names = ", ".join(sorted(name_of(agent) for agent in request.declined))
        return Choice(
            None,
            message(
                "allocation.all_declined",
                "{declined} declined, and nobody else has {needed}",
                declined=names,
                needed=request.described,
            ),
            is_final=are_known,
        )
    return Choice(None, message("allocation.nobody", "nobody has {needed}", needed=request.described))


def name_of(urn: str) -> str:
    """Return the last part of a URN."""
    return urn.rpartition(":")[2]


def joined(parts: Sequence[Message]) -> Message:
    """Return the first parts as one text."""
    joined = parts[0]
    for part in parts[1 : MAX_OTHERS + 1]:
        joined = message("allocation.joined", "{first}; {second}", first=joined, second=part)
    if len(parts) > MAX_OTHERS + 1:
        joined = message(
            "allocation.and_more", "{first}; {count} more", first=joined, count=len(parts) - MAX_OTHERS - 1
        )
    return joined
