"""Documents of agents: Devices and Persons that perform Tasks."""

from collections.abc import Iterable
from datetime import datetime
from typing import Annotated, Any, NotRequired

from typing_extensions import TypedDict

from handover_datamodels.entities import TaskStatus
from handover_datamodels.times import iso
from handover_processes.allocation.agents import UNLIMITED, Agent
from handover_processes.allocation.allocator import Allocator
from handover_processes.documents.document import Coded, From, document
from handover_processes.records.tasks import TaskRecord


class ShiftView(TypedDict):
    """A time of a weekday (Monday is 1) in which an agent works."""

    weekday: int
    begins: Annotated[str, From(lambda shift: f"{shift.begins:%H:%M}")]
    ends: Annotated[str, From(lambda shift: f"{shift.ends:%H:%M}")]
    zone: Annotated[str, From(lambda shift: shift.zone.key)]


class AgentTask(TypedDict):
    """An open Task of an agent, and why the agent got it."""

    id: str
    process: str
    element: str
    name: Annotated[str, From(lambda task: task.name or task.element)]
    status: TaskStatus
    since: Annotated[str, From(lambda task: iso(task.status_since or task.created_at))]
    allocated: Annotated[str | None, Coded()]
    allocatedCode: NotRequired[str]
    allocatedParameters: NotRequired[dict[str, Any]]


class SkillView(TypedDict):
    """How well an agent has a skill."""

    level: float
    cost: float
    speed: float


def _capacity(agent: Agent) -> int | None:
    return None if agent.capacity >= UNLIMITED else agent.capacity


def _coordinates(agent: Agent) -> list[float] | None:
    return None if agent.position is None else list(agent.position.coordinates)


def _is_geographic(agent: Agent) -> bool:
    return agent.position is not None and agent.position.is_geographic


class AgentView(TypedDict):
    """A Device or Person that performs Tasks; `tasks` are its open ones, without cancelled ones.

    A `capacity` of null is unlimited. `position` is in metres, or longitude and latitude in degrees if
    `isGeographic`. `reservedBy` is the process that has reserved it.
    """

    id: str
    isPerson: bool
    skills: dict[str, SkillView]
    roles: Annotated[list[str], From(lambda agent: sorted(agent.roles))]
    capacity: Annotated[int | None, From(_capacity)]
    unavailable: str | None
    isOnShift: bool
    shifts: list[ShiftView]
    position: Annotated[list[float] | None, From(_coordinates)]
    isGeographic: Annotated[bool, From(_is_geographic)]
    tasks: list[AgentTask]
    reservedBy: str | None


def agent_views(allocator: Allocator, tasks: Iterable[TaskRecord], now: datetime) -> list[AgentView]:
    """Return the agents with their open Tasks."""
    by_agent: dict[str, list[AgentTask]] = {}
    for task in tasks:
        if task.cancelled_at is None and task.performer:
            by_agent.setdefault(task.performer, []).append(document(AgentTask, task))
    holds = {agent: allocator.reservations.holding(agent) for agent in allocator.rules.agents.by_id}
    return [
        document(
            AgentView,
            agent,
            isOnShift=agent.works_at(now),
            tasks=by_agent.get(agent.id, []),
            reservedBy=None if (hold := holds[agent.id]) is None else hold.holder[0],
        )
        for agent in allocator.rules.agents.by_id.values()
    ]
