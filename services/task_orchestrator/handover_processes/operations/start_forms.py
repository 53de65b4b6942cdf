"""Start forms: the form of the variables that a person or another system starts a process with."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from handover.errors import Problem
from handover.messages import message, with_code
from handover_bpmn.forms import form
from handover_bpmn.forms.form_js import Resolved
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.model import Definition
from handover_processes.deployed_forms import FormRegistry
from handover_processes.process.task_creation import form_version


class FormOfStart:
    """The start form of a version of a definition.

    `id` and `version` are those of a deployed form; `schema` is None without a form, and for one that is not
    deployed.
    """

    def __init__(
        self, definition: Definition, forms: FormRegistry, deployed_at: datetime, now: datetime
    ) -> None:
        self.id: str | None = None
        self.version: int | None = None
        self.schema: form.Schema | None = None
        self._definition = definition
        form_ = definition.start_form
        if form_.reference is not None:
            self.id, version = form_version(form_.reference, forms, deployed_at, now)
            record = forms.find(self.id, version) if version is not None else None
            if record is not None:
                self.version, self.schema = record.version, forms.schema(record)
        elif form_.written is not None:
            self.schema = _evaluated(form_.written.value)

    def resolve(self, variables: Mapping[str, Any]) -> Resolved | None:
        """Return the fields for the variables typed so far; None if the definition has no form."""
        if not self._definition.start_form:
            return None
        if self.schema is None:
            return Resolved((), is_dynamic=False)
        return form.resolve(self.schema, variables)

    def arguments(self, variables: Mapping[str, Any]) -> dict[str, Any]:
        """Return the initial variables of a process; the form sets read-only and computed ones.

        Raises `Problem` 422 with the faults by field if they do not fit the form or the parameters.
        """
        if self.schema is None:
            return self._definition.arguments(variables)
        values, faults = form.check(self.schema, {}, variables)
        if faults:
            fields = ", ".join(fault.path or "-" for fault in faults)
            raise Problem(
                422,
                "Bad start variables",
                message(
                    "process.bad_start_variables",
                    "the start form of {definition} refuses the variables; see {fields}",
                    definition=self._definition.name,
                    fields=fields,
                ),
                "urn:handover:bad-result",
                {"faults": [{"field": fault.path, **with_code("reason", fault.reason)} for fault in faults]},
            )
        return self._definition.arguments({**variables, **values}, values.keys() | variables.keys())


def _evaluated(value: Any) -> form.Schema | None:
    """Return a written form; expressions of default values have no variables yet."""
    try:
        written = value({})
    except ExpressionError:
        return None
    return written if isinstance(written, Mapping) else None
