"""Definition: a process that can be started, and the faults of its file."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from handover.errors import Problem
from handover_bpmn.languages.base import Expression, quote_names
from handover_bpmn.model.activities import Activity, StartForm
from handover_bpmn.model.events import ConditionalEvent, MessageEvent, SignalEvent
from handover_bpmn.model.nodes import Kind, Node, Scope, entity_filter


@dataclass(frozen=True, slots=True)
class ProcessParameter:
    """A parameter of a process."""

    name: str
    required: bool
    default: Any = None


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of a BPMN file, or a warning: element (if any) with its drawn name, line, and rule."""

    element: str | None
    line: int | None
    message: str
    name: str | None = None

    def __str__(self) -> str:
        drawn = f' ("{self.name}")' if self.name and self.name != self.element else ""
        where = f'"{self.element}"{drawn}' if self.element else drawn[2:-1] or "the file"
        return f"line {self.line}, {where}: {self.message}" if self.line else f"{where}: {self.message}"


@dataclass(frozen=True, slots=True)
class Definition:
    """A process that can be started."""

    name: str
    """The id of the process in the file."""
    title: str
    label: str | None
    """The version label (version tag) of the author, if any."""
    description: str | None
    parameters: Mapping[str, ProcessParameter]
    scope: Scope
    xml: bytes = field(repr=False)
    warnings: tuple[Fault, ...] = ()
    source: str | None = None
    """The ProcessDefinition of another system that it was deployed from."""
    start_form: StartForm = field(default_factory=StartForm)
    """That of the none start event."""
    naming: Expression | None = None
    """Yields the title of a process."""
    translations: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """The texts of the file in other languages: by language (BCP 47), then by the text of the file."""

    def scopes(self) -> Iterator[Scope]:
        """Yield all scopes, the process first."""
        return self.scope.walk()

    def nodes(self) -> Iterator[Node]:
        """Yield the nodes of all scopes."""
        for scope in self.scopes():
            yield from scope.nodes.values()

    def entity_events(self) -> tuple[Node, ...]:
        """Return the nodes whose event is the creation or change of an entity."""
        return tuple(node for node in self.nodes() if entity_filter(node) is not None)

    @property
    def is_event_driven(self) -> bool:
        """Return whether messages, signals or entities can start a process or change a running one.

        Only such a definition has to be known before somebody starts a process of it.
        """
        events = [node.event for node in self.scope.nodes.values() if node.kind is Kind.START_EVENT]
        return bool(self.entity_events()) or any(
            isinstance(event, MessageEvent | SignalEvent | ConditionalEvent) for event in events
        )

    def activities(self) -> dict[str, Activity]:
        """Return the activities that create Tasks, by the id of their node."""
        return {node.id: node.activity for node in self.nodes() if node.activity is not None}

    def arguments(self, values: Mapping[str, Any], form: Collection[str] = ()) -> dict[str, Any]:
        """Return the initial variables of a process, including defaults.

        `form` are the names of the variables of its start form. Raises `Problem` 422 when one is missing or
        unknown.
        """
        unknown = sorted(set(values) - set(self.parameters) - set(form)) if self.parameters else []
        missing = sorted(p.name for p in self.parameters.values() if p.required and p.name not in values)
        if unknown:
            names = quote_names(self.parameters)
            raise Problem.translated(
                422,
                "Unknown parameter",
                "process.unknown_parameter",
                '"{unknown}" is no parameter of {definition}; its parameters are: {known}',
                unknown=unknown[0],
                definition=self.name,
                known=names,
            )
        if missing:
            raise Problem.translated(
                422,
                "Missing parameter",
                "process.missing_parameter",
                '{definition} cannot start without "{missing}"',
                definition=self.name,
                missing=missing[0],
            )
        return {**{p.name: p.default for p in self.parameters.values()}, **values}
