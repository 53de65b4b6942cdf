"""Report: the Process entity in the broker, and the Alerts about incidents."""

from datetime import datetime

from handover_bpmn.execution.queries import OpenIncident
from handover_processes.process import alerts
from handover_processes.process.process_state import ProcessState
from handover_processes.process.task_creation import task_id_of
from handover_processes.records.entities import MAX_LISTED_TASKS, definition_id, entity_of
from handover_processes.records.messages import MessageKind
from handover_processes.records.processes import IncidentRecord
from handover_processes.records.step import Step

REPORTED_TASKS = 10
"""Beyond `MAX_LISTED_TASKS` the Process entity is written with every so many new Tasks."""


def update_incidents(process: ProcessState, step: Step) -> None:
    """Record the incidents; raise the Alerts of new ones and clear those of others."""
    recorded = {incident.token: incident for incident in process.record.incidents}
    present = {}
    for open_incident in process.run.incidents() if process.run is not None else ():
        before = recorded.get(open_incident.token)
        is_same = before is not None and (before.since, before.element) == (
            open_incident.since,
            open_incident.element,
        )
        present[open_incident.token] = (
            before if before is not None and is_same else _incident(process, open_incident)
        )
    for token, incident in recorded.items():
        if present.get(token) is not incident:
            alerts.clear_incident(step, process.record, process.urn, incident)
    for token, incident in present.items():
        if recorded.get(token) is not incident:
            alerts.raise_incident(step, process.record, process.urn, incident)
    process.revise(incidents=tuple(present.values()))


def _incident(process: ProcessState, incident: OpenIncident) -> IncidentRecord:
    failed = incident.details.get("task")
    if not failed and incident.visit:
        failed = task_id_of(process.settings, process.record.id, incident.element, incident.visit)
    code = incident.details.get("code")
    return IncidentRecord(
        token=incident.token,
        element=incident.element,
        name=incident.name,
        reason=incident.reason,
        since=incident.since,
        task=failed if failed in process.composed else None,
        code=None if code is None else str(code),
    )


def is_report_due(process: ProcessState) -> bool:
    """Return whether the Process entity has to be written: at each state, and when it has more Tasks.

    The entity lists the last Tasks, and new ones of a long process are reported in groups, so that a step
    costs the same however long the process has run.
    """
    if process.reported is None or process.reported[0] is not process.record.status:
        return True
    listed = process.reported[1]
    new = len(process.composed) - listed
    return new >= (1 if listed < MAX_LISTED_TASKS else REPORTED_TASKS)


def report_state(process: ProcessState, step: Step, now: datetime) -> None:
    """Write the state of the process to the broker."""
    process.reported = (process.record.status, len(process.composed))
    defined_by = definition_id(process.settings, process.plan.definition)
    entity = entity_of(process.settings, process.record, defined_by, process.composed, now)
    step.enqueue(process.record.id, MessageKind.UPSERT, process.urn, [entity])
