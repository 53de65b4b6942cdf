"""A library of definitions in memory, for programs that execute processes without the orchestrator."""

from collections.abc import Iterable

from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.state import Library, RunFailed
from handover_bpmn.model import Definition


class Definitions(Library):
    """Definitions, each with one version and without a version tag."""

    def __init__(self, definitions: Iterable[Definition]) -> None:
        self.plans = {definition.name: Plan(definition) for definition in definitions}

    def plan(self, name: str, version: int) -> Plan:
        """Return a definition; raise `RunFailed` if there is none of this name."""
        return self.find(name, version, None)

    def find(self, name: str, version: int | None, tag: str | None) -> Plan:  # noqa: ARG002
        """Return a definition; raise `RunFailed` if there is none of this name."""
        if name not in self.plans:
            raise RunFailed(f'there is no definition "{name}"')
        return self.plans[name]
