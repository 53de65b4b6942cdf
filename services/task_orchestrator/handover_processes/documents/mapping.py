"""Documents of the mapping of names in process files to performers."""

from collections.abc import Iterable
from types import SimpleNamespace
from typing import Annotated, Any, NotRequired

from typing_extensions import TypedDict

from handover_bpmn.model import Definition
from handover_processes.allocation.allocator import Allocator
from handover_processes.allocation.assignment import performer_of
from handover_processes.allocation.mapping import MappingTable, NameKind
from handover_processes.allocation.report import UsedName, mapped_names, nobody_has
from handover_processes.documents.document import Coded, From, OptionalMoment, coded, document, documents


class MappedName(TypedDict):
    """An entry of the mapping: a name in process files, and its resource, its role or its skills."""

    kind: NameKind
    name: str
    resource: NotRequired[str]
    role: NotRequired[str]
    skills: NotRequired[list[str]]
    definition: NotRequired[str]
    parameters: NotRequired[dict[str, Any]]


class MappingView(TypedDict):
    """A version of the mapping; `verified`: `by` is the name of who was signed in."""

    version: int
    by: str | None
    verified: bool
    why: str | None
    at: OptionalMoment
    entries: list[MappedName]


class NamedActivity(TypedDict):
    """An activity of the latest version of a definition."""

    definition: str
    element: str
    name: str


def _performer(used: UsedName) -> str | None:
    return None if used.entry is None else performer_of(used.entry)


def _activities(used: UsedName) -> list[SimpleNamespace]:
    keys = ("definition", "element", "name")
    return [SimpleNamespace(**dict(zip(keys, activity, strict=True))) for activity in used.activities]


class UsedNameView(TypedDict):
    """A name in deployed definitions that the mapping can relate to a performer.

    `performer` is null without an entry: then people of the tasklist get the work.
    """

    kind: NameKind
    name: str
    performer: Annotated[str | None, From(_performer)]
    activities: Annotated[list[NamedActivity], From(_activities)]


class MissingSkills(TypedDict):
    """An entry of the mapping whose role or skills no agent has."""

    kind: NameKind
    name: str
    warning: Annotated[str, Coded()]
    warningCode: NotRequired[str]
    warningParameters: NotRequired[dict[str, Any]]


class MappingUse(TypedDict):
    """How the mapping and the deployed definitions fit together."""

    names: list[UsedNameView]
    missing: list[MissingSkills]


def mapping_view(table: MappingTable) -> MappingView:
    """Return a version of the mapping."""
    entries = [entry.model_dump(mode="json", exclude_defaults=True) for entry in table.entries]
    return document(MappingView, table, entries=entries)


def mapping_use(allocator: Allocator, definitions: Iterable[Definition]) -> MappingUse:
    """Return the names in definitions with their performers, and the entries that nobody can serve."""
    rules = allocator.rules
    warnings = [(entry, nobody_has(rules, entry)) for entry in rules.mapping.entries]
    return {
        "names": documents(UsedNameView, mapped_names(rules, definitions)),
        "missing": [
            document(MissingSkills, entry, **coded("warning", warning))
            for entry, warning in warnings
            if warning is not None
        ],
    }
