"""Who answered a Task: what only our services write, since they identify the person.

`outputParameters.performedBy` names the Person who was signed in or wore the glove; a client never sets it.
A Task that demands a PIN (`requirePin`) is answered by the service that has checked the PIN: nobody else
changes its `status`, its parameters or its definition, or deletes it before it has ended. Other callers with
the permission `writeEntities` change everything else of a Task.
"""

from collections.abc import Callable, Iterator
from typing import Any, Final

from handover.errors import Problem
from handover.security.proofs.pin_check import PIN_REQUIRED
from handover_broker.model.entity import VALUE_MEMBER, Entity, Event
from handover_datamodels.entities import TaskStatus

TASK: Final = "Task"
_STATUS: Final = "status"
_OUTPUTS: Final = "outputParameters"
_INPUTS: Final = "workParameters"
_DEFINITION: Final = "isDefinedBy"
_INVOLVES: Final = "involves"
_OF_PERFORMERS: Final = frozenset({_STATUS, _OUTPUTS})
"""What the performer of a Task writes."""
_EVIDENCE: Final = frozenset({_STATUS, _OUTPUTS, _INPUTS, _DEFINITION})
_ENDED: Final = frozenset({TaskStatus.COMPLETED.value, TaskStatus.FAILED.value})


def task_refusal(event: Event, find: Callable[[str], Entity | None]) -> Problem | None:
    """Return why a caller that is no service may not make a change of a Task; None if it may.

    `find` returns an entity of the tenant, as the last write left it.
    """
    before, after = event.before, event.after
    if after is not None and _performed_by(after) != ([] if before is None else _performed_by(before)):
        return Problem(
            403,
            "Not allowed",
            f"performedBy of {after.id} names the person whom a service has identified, so that no client "
            "changes it; leave it as it is, or complete the Task on the page Tasks",
        )
    task = before or after
    assert task is not None  # noqa: S101 - a change has at least one end
    if not _demands_pin(task, find):
        return None
    status = set(_values(task, _STATUS))
    if before is None:
        is_refused = status != {TaskStatus.PENDING.value}
    elif after is None:
        is_refused = not status & _ENDED
    else:
        is_refused = any(_instances(before, name) != _instances(after, name) for name in _EVIDENCE)
    if not is_refused:
        return None
    return Problem(
        403,
        "PIN required",
        f"{task.id} demands the PIN of the person who answers it, so that only the service that checks the "
        "PIN changes its status and parameters; answer it on the page Tasks or Work, or cancel its process",
        PIN_REQUIRED,
    )


def performer_refusal(event: Event) -> Problem | None:
    """Return why the performer of a Task, without other rights for it, may not make a change; None if it may.

    It writes the status and the result.
    """
    before, after = event.before, event.after
    if before is None or after is None:
        task = before or after
        assert task is not None  # noqa: S101 - a change has at least one end
        return _performer_denied(task)
    names = before.attributes.keys() | after.attributes.keys()
    changed = {_short(iri) for iri in names if before.attributes.get(iri) != after.attributes.get(iri)}
    is_allowed = changed <= _OF_PERFORMERS and before.types == after.types
    return None if is_allowed else _performer_denied(before)


def _performer_denied(task: Entity) -> Problem:
    return Problem(
        403,
        "Not allowed",
        f"the performer of {task.id} writes its status and outputParameters only; leave the rest as it is",
    )


def resources_of(task: Entity) -> list[str]:
    """Return the URNs of the resources that a Task involves, in their order."""
    return [urn for value in _values(task, _INVOLVES) for urn in _urns_in(value)]


def _urns_in(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, list):
        for inner in value:
            yield from _urns_in(inner)
    elif isinstance(value, dict):
        yield from _urns_in(value.get("object"))


def _short(iri: str) -> str:
    return iri.rpartition("/")[2].rpartition("#")[2]


def _demands_pin(task: Entity, find: Callable[[str], Entity | None]) -> bool:
    for inputs in _values(task, _INPUTS):
        if isinstance(inputs, dict) and "requirePin" in inputs:
            return inputs["requirePin"] is True
    definitions = (
        find(definition_id) for definition_id in _values(task, _DEFINITION) if isinstance(definition_id, str)
    )
    return any(
        True in _values(definition, "requirePin") for definition in definitions if definition is not None
    )


def _performed_by(task: Entity) -> list[Any]:
    return [
        outputs["performedBy"]
        for outputs in _values(task, _OUTPUTS)
        if isinstance(outputs, dict) and "performedBy" in outputs
    ]


def _values(entity: Entity, name: str) -> Iterator[Any]:
    for instance in _instances(entity, name):
        yield instance.get(VALUE_MEMBER[instance["type"]])


def _instances(entity: Entity, name: str) -> list[dict[str, Any]]:
    """Return the instances of an attribute in any vocabulary."""
    return [
        instance
        for iri, instances in entity.attributes.items()
        if _short(iri) == name
        for instance in instances
    ]
