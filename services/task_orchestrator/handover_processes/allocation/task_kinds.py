"""Task kinds: the TaskDefinitions of other systems that an engineer has accepted.

An activity that names such a definition gets what it does not say itself: the required skills, the
description, the gesture or command, and what is written to the specification database. The accepted content
stands in the Task, so a later change in the broker has no effect before it is accepted too.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from jsonschema.exceptions import SchemaError
from referencing.exceptions import Unresolvable

from handover.messages import message
from handover_bpmn.forms.json_schema import violations
from handover_bpmn.model import Activity, Value
from handover_datamodels.entities import TaskDefinition

OF_THE_PERSON = frozenset(
    {"description", "gesture", "commandId", "handlesOutcomes", "requirePin", "candidates", "form"}
)
"""Work parameters that describe the work to a person; a schema that does not name them allows them."""


@dataclass(frozen=True, slots=True)
class TaskKind:
    """What an accepted TaskDefinition says of its Tasks."""

    id: str
    skills: tuple[str, ...] = ()
    description: str | None = None
    gesture: str | None = None
    command_id: int | None = None
    require_pin: bool = False
    schema: Mapping[str, Any] | None = field(default=None, hash=False)
    specification: Mapping[str, Any] | None = field(default=None, hash=False)

    @classmethod
    def of(cls, definition: TaskDefinition) -> "TaskKind":
        """Return the kind that a TaskDefinition describes."""
        return cls(
            id=definition.id,
            skills=tuple(definition.required_skills.value) if definition.required_skills else (),
            description=definition.description.value if definition.description else None,
            gesture=definition.gesture.value if definition.gesture else None,
            command_id=definition.command_id.value if definition.command_id else None,
            require_pin=definition.require_pin is not None and definition.require_pin.value,
            schema=definition.work_parameters_schema.value if definition.work_parameters_schema else None,
            specification=definition.specification.value if definition.specification else None,
        )

    def completed(self, activity: Activity) -> Activity:
        """Return the activity with the texts, the command and the specification that it lacks itself."""
        added: dict[str, Value] = {}
        if self.description is not None and "description" not in activity.parameters:
            added["description"] = Value(self.description)
        if not {"gesture", "commandId"} & activity.parameters.keys():
            if self.gesture is not None:
                added["gesture"] = Value(self.gesture)
            if self.command_id is not None:
                added["commandId"] = Value(self.command_id)
        if self.specification is not None and activity.specification is None:
            written = {field: Value(value) for field, value in self.specification.items()}
            activity = replace(activity, specification=written)
        if self.require_pin and not activity.require_pin:
            activity = replace(activity, require_pin=True)
        return replace(activity, parameters={**added, **activity.parameters}) if added else activity

    def check(self, parameters: Mapping[str, Any]) -> None:
        """Raise `ValueError` with all faults if the work parameters do not match the schema."""
        if self.schema is None:
            return
        declared = self.schema.get("properties")
        named = declared if isinstance(declared, Mapping) else {}
        checked = {
            name: value for name, value in parameters.items() if name in named or name not in OF_THE_PERSON
        }
        try:
            faults = violations(self.schema, checked)
        except (SchemaError, Unresolvable, RecursionError) as error:
            raise ValueError(
                message(
                    "process.unusable_schema",
                    "the workParametersSchema of {definition} cannot be used: {why}",
                    definition=self.id,
                    why=str(error).splitlines()[0][:300],
                )
            ) from None
        if faults:
            raise ValueError(
                message(
                    "process.bad_work_parameters",
                    "the work parameters do not match {definition}: {faults}",
                    definition=self.id,
                    faults="; ".join(f"{fault.path or '-'}: {fault.reason}" for fault in faults),
                )
            )
