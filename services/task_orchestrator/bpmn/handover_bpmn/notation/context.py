"""Context: what the readers of nodes share while they read one process."""

from dataclasses import dataclass, field

from lxml import etree

from handover.messages import message
from handover_bpmn.notation.dialects.choice import Dialects
from handover_bpmn.notation.document import local
from handover_bpmn.notation.elements import Collaboration, Declarations
from handover_bpmn.notation.faults import Findings
from handover_bpmn.notation.names import MAX_NODE_ID, is_foreign_id, is_node_id, is_process_id, variable_of


@dataclass
class Context:
    """The file around a process, and the names that its elements use."""

    dialects: Dialects
    declared: Declarations
    collaboration: Collaboration
    findings: Findings
    ids: set[str]
    """The ids of the file that are used."""
    lanes: dict[str, str] = field(default_factory=dict)
    data: dict[str, str] = field(default_factory=dict)
    """Data object reference -> data object."""
    data_names: dict[str, str] = field(default_factory=dict)
    """Data object -> its name."""
    data_scopes: dict[str, set[str]] = field(default_factory=dict)
    """Process or subprocess -> its data objects."""
    associations: tuple[tuple[str, str], ...] = ()
    """The ends of the associations of the process and of the collaborations of the file."""
    properties: dict[str, str] = field(default_factory=dict)
    """Property, or other name that the file declares for a variable -> the variable."""
    variables: dict[str, str] = field(default_factory=dict)
    """Variable -> the element whose results it has."""
    _times: dict[str, int] = field(default_factory=dict)
    """How many elements have wanted a variable."""

    def id(self, element: etree._Element) -> str:
        """Return the id of an element; report it if it is invalid or used twice."""
        id_ = element.get("id") or ""
        if local(element) == "process" and not (
            is_process_id(id_) or (is_foreign_id(id_) and not self.dialects.is_ours)
        ):
            self.findings.fault(
                element,
                message(
                    "bpmn.wrong_process_id",
                    "a process needs an id of A-Z, a-z, 0-9, - _ . (at most 64 characters)",
                ),
            )
        elif not is_node_id(id_) and (self.dialects.is_ours or not is_foreign_id(id_)):
            self.findings.fault(
                element,
                message(
                    "bpmn.wrong_id",
                    "{element} needs an id of letters, digits, - _ . (at most {limit} characters)",
                    element=local(element),
                    limit=MAX_NODE_ID,
                ),
            )
        elif id_ in self.ids:
            self.findings.fault(element, message("bpmn.id_twice", 'the id "{id}" is used twice', id=id_))
        self.ids.add(id_)
        return id_

    def variable(self, element: etree._Element, name: str | None) -> str:
        """Return the variable for the results of an element; report it if it cannot be one.

        `name` is the one that the file gives. Ids such as `a-b` and `a.b` get different variables.
        """
        if name is not None:
            return name
        id_ = element.get("id") or ""
        variable = base = variable_of(id_)
        while self.variables.setdefault(variable, id_) != id_:
            self._times[base] = self._times.get(base, 1) + 1
            variable = f"{base}_{self._times[base]}"
        if variable != base:
            self.findings.warn(
                element,
                message(
                    "bpmn.variable_renamed",
                    'its results are in the variable "{variable}", since "{base}" has those of "{other}"',
                    variable=variable,
                    base=base,
                    other=self.variables[base],
                ),
            )
        return variable
