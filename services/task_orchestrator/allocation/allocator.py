"""Allocator: decides who performs an activity when its Task is posted.

The file decides if it names a resource, role or skills. Otherwise an entry of the mapping decides. Without
one the activity goes to people: its Task involves nobody, and its `candidates` say who may claim it.

For a role or skills an agent is chosen; if none can take the activity, it waits, and is tried again when
agents or their Tasks change. The allocator knows the open Tasks of each agent and the waiting activities of
all processes. The processes keep both up to date; nothing of this is stored, since it follows from them.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from handover.messages import Message, message, with_code
from services.task_orchestrator.allocation.agents import Agents, Position
from services.task_orchestrator.allocation.choice import (
    DEFAULT_PRIORITY,
    ChooseByRules,
    Chooser,
    Request,
    WaitingRequest,
)
from services.task_orchestrator.allocation.mapping import MappingEntry, MappingTable, NameKind
from services.task_orchestrator.languages.base import ExpressionError, Variables
from services.task_orchestrator.languages.feel import read_feel
from services.task_orchestrator.languages.juel import read_template
from services.task_orchestrator.languages.times import read_datetime
from services.task_orchestrator.model import Activity, Definition, Value
from services.task_orchestrator.references import is_reference, resource_id
from services.task_orchestrator.settings import OrchestratorSettings

_HINT_KINDS: Mapping[NameKind, tuple[str, ...]] = {
    NameKind.CLASS: ("class", "delegateExpression", "expression", "connector"),
    NameKind.TOPIC: ("topic",),
    NameKind.JOB_TYPE: ("jobType",),
    NameKind.ASSIGNEE: ("assignee",),
    NameKind.CANDIDATE_GROUP: ("candidateGroups",),
}
_CODE_HINTS = frozenset(_HINT_KINDS[NameKind.CLASS])
"""Hints whose text is the name of code, even if it is written as an expression."""


@dataclass(frozen=True, slots=True)
class Assignment:
    """Who gets an activity: `activity` is changed as the mapping says."""

    activity: Activity
    reason: Message
    performer: str | None = None
    """The resource, role or skills, as text; None if people of the tasklist claim it."""
    candidates: Mapping[str, Any] | None = None
    """Who may claim its Task, if the Task involves nobody."""
    warning: Message | None = None
    request: Request | None = None
    """What a performer needs, if one has to be chosen."""


@dataclass(frozen=True, slots=True)
class NoPerformer:
    """Nobody can take an activity now; `is_final` if all have declined it."""

    reason: Message
    request: Request
    is_final: bool


class Allocator:
    """The decisions of one orchestrator; `mapping` is the present version of the table."""

    def __init__(self, settings: OrchestratorSettings, chooser: Chooser | None = None) -> None:
        self._settings = settings
        self._chooser: Chooser = chooser or ChooseByRules()
        self.mapping = MappingTable()
        self.agents = Agents()
        self.has_changed = False
        """Whether waiting activities should be tried again: an agent or its Tasks have changed."""
        self._tasks: dict[str, str] = {}
        self._loads: dict[str, dict[str, None]] = {}
        self._waiting: dict[tuple[str, str], WaitingRequest] = {}

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

    def add_waiting(self, process: str, token: str, request: Request, since: datetime) -> None:
        """Let the activity of a token wait for an agent."""
        key = process, token
        self._waiting[key] = WaitingRequest(request, since, key)

    def remove_waiting(self, process: str, token: str) -> None:
        """Handle that an activity no longer waits."""
        if self._waiting.pop((process, token), None) is not None:
            self.has_changed = True

    def waiting(self) -> list[str]:
        """Return the processes with waiting activities, in the order in which they are served."""
        ordered = sorted(self._waiting.values(), key=lambda each: each.order)
        return list(dict.fromkeys(each.key[0] for each in ordered))

    # Decisions

    def request(
        self, activity: Activity, variables: Variables, declined: frozenset[str] = frozenset()
    ) -> Assignment:
        """Return who gets an activity, with everything that the choice of an agent depends on."""
        assignment = self.assign(activity, variables)
        if assignment.request is None:
            return assignment
        request = replace(
            assignment.request,
            declined=declined,
            place=self._place(activity, variables),
            priority=_priority(activity, variables),
            due=_due(activity, variables),
        )
        return replace(assignment, request=request)

    def choose(
        self, assignment: Assignment, key: tuple[str, str], since: datetime, now: datetime
    ) -> Assignment | NoPerformer:
        """Return the assignment to an agent, if one has to be chosen; `key` are process and token."""
        request = assignment.request
        if request is None:
            return assignment
        agents = list(self.agents.by_id.values())
        loads = {agent: list(tasks) for agent, tasks in self._loads.items()}
        chosen = self._chooser.choose(request, agents, loads, (), now)
        if chosen.agent is not None and self._waiting:
            mine = WaitingRequest(request, since, key)
            before = [each for each in self._waiting.values() if each.key != key and each.order < mine.order]
            if before:
                chosen = self._chooser.choose(request, agents, loads, before, now)
        if chosen.agent is None:
            return NoPerformer(chosen.reason, request, chosen.is_final)
        activity = replace(assignment.activity, involves=(Value(chosen.agent),))
        return replace(assignment, activity=activity, reason=chosen.reason)

    def assign(self, activity: Activity, variables: Variables | None) -> Assignment:
        """Return who gets an activity with the present `variables`; None: before it runs."""
        if activity.involves:
            named = ", ".join(_described(value) for value in activity.involves)
            reason = message("allocation.by_file", "the file names {resource}", resource=named)
            return Assignment(activity, reason, named)
        if activity.role is not None or activity.skills:
            request = Request(activity.role, activity.skills)
            reason = message("allocation.needs", "the file asks for {needed}", needed=request.described)
            return Assignment(
                activity, reason, request.described, request=request, warning=self._nobody_has(request)
            )
        entry = self.mapping.find(_names(activity, variables))
        if entry is None:
            reason = message("allocation.no_entry", "people, because the mapping has no entry for it")
            return Assignment(activity, reason, candidates=_candidates(activity, variables))
        if not self._is_allowed(entry):
            warning = message(
                "allocation.unconfirmed",
                'people, because nobody has confirmed the mapping of {kind} "{name}" to {performer}',
                kind=entry.kind.value,
                name=entry.name,
                performer=performer_of(entry),
            )
            return Assignment(activity, warning, candidates=_candidates(activity, variables), warning=warning)
        return self._by_entry(activity, entry)

    def _by_entry(self, activity: Activity, entry: MappingEntry) -> Assignment:
        changed = replace(
            activity,
            definition=entry.definition or activity.definition,
            parameters={
                **activity.parameters,
                **{name: Value(value) for name, value in entry.parameters.items()},
            },
            involves=() if entry.resource is None else (Value(entry.resource),),
        )
        request = None
        if entry.resource is None:
            people_only = self.mapping.by is None
            request = Request(entry.role, entry.skills or (), people_only=people_only)
        return Assignment(
            changed,
            message(
                "allocation.by_entry",
                '{performer}, by the mapping of {kind} "{name}" (version {version})',
                performer=performer_of(entry),
                kind=entry.kind.value,
                name=entry.name,
                version=self.mapping.version,
            ),
            performer_of(entry),
            request=request,
            warning=None if request is None else self._nobody_has(request),
        )

    def report(self, definition: Definition) -> list[dict[str, Any]]:
        """Return for each activity of a definition who gets it and why, as JSON."""
        found = []
        for element, activity in definition.activities().items():
            assignment = self.assign(activity, None)
            view = {
                "process": definition.name,
                "element": element,
                "name": activity.name,
                "definition": assignment.activity.definition,
                "performer": assignment.performer,
                **with_code("reason", assignment.reason),
                "warning": None,
            }
            if assignment.warning is not None:
                view |= with_code("warning", assignment.warning)
            found.append(view)
        return found

    def _nobody_has(self, request: Request) -> Message | None:
        if any(request.suits(agent) for agent in self.agents.by_id.values()):
            return None
        return message("allocation.nobody", "nobody has {needed}", needed=request.described)

    def _is_allowed(self, entry: MappingEntry) -> bool:
        """Return whether work may be given to the performer: people always, others if confirmed."""
        if self.mapping.by is not None:
            return True
        return entry.resource is None or entry.resource.startswith(("Person:", "urn:ngsi-ld:Person:"))

    def _place(self, activity: Activity, variables: Variables) -> Position | None:
        """Return the position of the first place of an activity that has one."""
        for place in activity.happens_at:
            reference = place.location.value(variables)
            if is_reference(reference):
                found = self.agents.places.get(resource_id(self._settings, str(reference)))
                if found is not None:
                    return found
        return None


def performer_of(entry: MappingEntry) -> str:
    """Return the performer of an entry as text: `Device:ur10-1`, `role:operator`, `skill:grip`."""
    if entry.resource is not None:
        return entry.resource
    if entry.role is not None:
        return f"role:{entry.role}"
    return " ".join(f"skill:{skill}" for skill in entry.skills or ())


def _names(activity: Activity, variables: Variables | None) -> Iterator[tuple[NameKind, str]]:
    """Yield the names of an activity that an entry can map, the most specific first."""
    yield NameKind.DEFINITION, activity.definition
    for kind, hints in _HINT_KINDS.items():
        for hint in hints:
            for name in _hint(activity, hint, variables):
                yield kind, name
                if hint in _CODE_HINTS and name.startswith(("${", "#{")) and name.endswith("}"):
                    yield kind, name[2:-1].strip()
    if activity.lane:
        yield NameKind.LANE, activity.lane


def _priority(activity: Activity, variables: Variables) -> int:
    for name in ("priority", "taskPriority"):
        for text in _hint(activity, name, variables):
            with suppress(ValueError):
                return int(text)
    return DEFAULT_PRIORITY


def _due(activity: Activity, variables: Variables) -> datetime | None:
    texts = _hint(activity, "dueDate", variables)
    due = read_datetime(texts[0]) if texts else None
    return due.replace(tzinfo=UTC) if due is not None and due.tzinfo is None else due


def _candidates(activity: Activity, variables: Variables | None) -> dict[str, Any]:
    found: dict[str, Any] = {
        "groups": _hint(activity, "candidateGroups", variables),
        "users": _hint(activity, "candidateUsers", variables),
        "assignee": next(iter(_hint(activity, "assignee", variables)), None),
        "lane": activity.lane,
    }
    return {name: value for name, value in found.items() if value}


def _hint(activity: Activity, name: str, variables: Variables | None) -> list[str]:
    """Return the names in a hint; an expression that cannot be evaluated stands for itself."""
    text = activity.hints.get(name, "").strip()
    if not text:
        return []
    value: Any = text
    if variables is not None and name not in _CODE_HINTS:
        with suppress(ExpressionError):
            if text.startswith("="):
                value = read_feel(text).value(variables)
            elif "${" in text or "#{" in text:
                value = read_template(text).value(variables)
    if isinstance(value, list):
        return [str(each).strip() for each in value if each is not None]
    if value is text and (text.startswith("=") or "${" in text or "#{" in text):
        return [text]
    is_list = name in {"candidateGroups", "candidateUsers"}
    names = str(value).split(",") if is_list else [str(value)]
    return [each.strip() for each in names if each.strip() and value is not None]


def _described(value: Value) -> str:
    if value.expression is not None:
        return value.expression.text
    return str(value.literal) if is_reference(value.literal) else repr(value.literal)
