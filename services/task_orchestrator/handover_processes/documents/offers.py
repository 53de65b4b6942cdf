"""Documents of offers: definitions of other systems."""

from types import SimpleNamespace
from typing import Annotated, Any, Literal

from typing_extensions import TypedDict

from handover_bpmn.notation.comparison import ElementChange
from handover_bpmn.notation.faults import as_json
from handover_datamodels.forms import to_key_values
from handover_processes.documents.definitions import ActivityAllocation, BpmnWarning, CheckedDefinition
from handover_processes.documents.document import From, Moment, document
from handover_processes.records.offers import Decision, OfferRecord, OfferStatus


class DeployedVersion(TypedDict):
    """A version of a definition that was deployed from an offer."""

    name: str
    version: int


def _deployed(decision: Decision) -> list[SimpleNamespace]:
    return [SimpleNamespace(name=name, version=version) for name, version in decision.deployed]


def _attributes(record: OfferRecord) -> dict[str, Any]:
    values = to_key_values(record.content)
    return {name: value for name, value in values.items() if name not in {"id", "type"}}


class OfferDecision(TypedDict):
    """A decision about an offer; `by` is the name that was given."""

    at: Moment
    status: OfferStatus
    by: str
    verified: bool
    why: str | None
    deployed: Annotated[list[DeployedVersion], From(_deployed)]


class OfferedChange(TypedDict):
    """An element of a process, or an attribute of an entity, that the acceptance would change."""

    process: str | None
    element: str
    name: str | None
    change: Literal["added", "removed", "changed"]
    before: Any
    after: Any


class OfferView(TypedDict):
    """A definition of another system; `definitions`, `changes` and `allocation` are of open offers only."""

    id: str
    entity: str
    type: str
    name: str
    status: OfferStatus
    foundAt: Moment
    times: int
    inForce: bool
    hasFile: bool
    attributes: Annotated[dict[str, Any], From(_attributes)]
    faults: list[BpmnWarning]
    warnings: list[BpmnWarning]
    decisions: list[OfferDecision]
    definitions: list[CheckedDefinition]
    changes: list[OfferedChange]
    allocation: list[ActivityAllocation]


def offer_view(record: OfferRecord) -> OfferView:
    """Return an offer, without what its acceptance would change."""
    return document(
        OfferView,
        record,
        faults=as_json(record.faults),
        warnings=as_json(record.warnings),
        definitions=[],
        changes=[],
        allocation=[],
    )


def changed_attributes(before: OfferRecord | None, after: OfferRecord) -> list[OfferedChange]:
    """Return the attributes in which an offer differs from the content in force."""
    old, new = {} if before is None else _attributes(before), _attributes(after)
    return [
        {
            "process": None,
            "element": name,
            "name": None,
            "change": "added" if name not in old else "removed" if name not in new else "changed",
            "before": old.get(name),
            "after": new.get(name),
        }
        for name in {**new, **old}
        if old.get(name) != new.get(name)
    ]


def element_change_view(change: ElementChange) -> OfferedChange:
    """Return an element of a process that would change."""
    return document(OfferedChange, change, before=None, after=None)
