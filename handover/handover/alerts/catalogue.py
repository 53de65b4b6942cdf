"""The Alerts of all services: category, subcategory and severity of each, in one place.

An integrator subscribes to Alerts by category and subcategory, and the page explains the subcategories that
it knows. `docs/reference/alerts.md` shows the same table. Rules of a ROS mapping define Alerts of their own.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from handover_datamodels.states import Severity


class AlertCategory(StrEnum):
    """The part of the system in which a person has to act."""

    DEVICE = "device"
    TASK = "task"
    PROCESS = "process"
    SYSTEM = "system"
    ROS = "ros"


@dataclass(frozen=True, slots=True)
class AlertType:
    """A kind of Alert; `meaning` says when it is raised, and `action` what a person does."""

    category: str
    sub_category: str | None
    severity: Severity
    source: str = ""
    """The type of the entity that `alertSource` refers to."""
    meaning: str = ""
    action: str = ""


GLOVE_SILENT: Final = AlertType(
    AlertCategory.DEVICE,
    "gloveSilent",
    Severity.HIGH,
    "Device",
    "A glove sends no frames while a Task waits for its wearer; the Task is paused.",
    "Check that the glove is switched on, charged and in range, or complete the Task on the page.",
)
CALIBRATION_NEEDED: Final = AlertType(
    AlertCategory.DEVICE,
    "calibrationNeeded",
    Severity.MEDIUM,
    "Device",
    "The values of a glove no longer match its calibration.",
    "Calibrate the glove on the page *Calibrate*.",
)
UNKNOWN_GESTURE: Final = AlertType(
    AlertCategory.TASK,
    "unknownGesture",
    Severity.MEDIUM,
    "Task",
    "A Task asks for a gesture or a command that is not configured; the Task has failed.",
    "Correct the Task's definition or the gestures file.",
)
TASK_NOT_ACCEPTED: Final = AlertType(
    AlertCategory.TASK,
    "taskNotAccepted",
    Severity.HIGH,
    "Task",
    "No performer accepted a Task before its deadline.",
    "Start the component that acts for the involved resource, or cancel the process.",
)
TASK_PAST_DUE: Final = AlertType(
    AlertCategory.TASK,
    "taskPastDue",
    Severity.MEDIUM,
    "Task",
    "A Task has not ended at its due date, or a level of its escalation was reached.",
    "Complete the Task, or ask somebody else to.",
)
TASK_PERFORMER_LOST: Final = AlertType(
    AlertCategory.TASK,
    "taskPerformerLost",
    Severity.HIGH,
    "Task",
    "The performer of a Task in progress has lost the lease of its Device: it was killed, paused or cut off.",
    "Look at the machine, and start the performer again; otherwise the process asks, retries or waits, as "
    "its definition says.",
)
TASK_LOST: Final = AlertType(
    AlertCategory.TASK,
    "taskLost",
    Severity.HIGH,
    "Task",
    "The broker no longer has a Task that a performer had started.",
    "Check the state of the work, then cancel the process.",
)
TASK_UNREADABLE: Final = AlertType(
    AlertCategory.TASK,
    "taskUnreadable",
    Severity.HIGH,
    "Task",
    "A program has written a Task against the data model, for example an unknown status; the process waits.",
    "Correct the program that the Alert names, and let it write the Task again. With accounts, the audit log "
    "of the broker names the account that wrote it.",
)
PROCESS_FAILED: Final = AlertType(
    AlertCategory.PROCESS,
    "processFailed",
    Severity.HIGH,
    "Process",
    "A process ended by an error that its model does not catch.",
    "Remove the cause that the Alert names, then start a new process.",
)
PROCESS_INCIDENT: Final = AlertType(
    AlertCategory.PROCESS,
    "processIncident",
    Severity.HIGH,
    "Process",
    "A part of a process cannot continue: a Task failed, no condition holds, or a variable is missing. "
    "Other parts of the process continue.",
    "Remove the cause that the Alert names, then retry, skip or move it on the page.",
)
ENTITY_FILTER_REFUSED: Final = AlertType(
    AlertCategory.PROCESS,
    "entityFilterRefused",
    Severity.HIGH,
    "ProcessDefinition",
    "The broker refuses the filter of an event that waits for entities, so the event never occurs.",
    "Correct the `q` or `idPattern` of `handover:on` and deploy the file again.",
)
DEVICE_ANOMALY: Final = AlertType(
    AlertCategory.DEVICE,
    "deviceAnomaly",
    Severity.MEDIUM,
    "Device",
    "A value of a device is abnormal by a rule of the device gateway; the severity is that of the rule.",
    "Look at the device and at the chart of the value; correct the rule if the value is usual.",
)
DEVICE_CERTIFICATE_EXPIRES: Final = AlertType(
    AlertCategory.DEVICE,
    "deviceCertificateExpires",
    Severity.HIGH,
    "Device",
    "The client certificate of a device expires within a week, or has expired.",
    "Make a new one with `handover device certificate`, or on the page *Devices*, and copy it to the device.",
)
ROBOT_STOPPED_BY_LIMIT: Final = AlertType(
    AlertCategory.DEVICE,
    "robotStoppedByLimit",
    Severity.HIGH,
    "Device",
    "A limit for the protection of people has stopped a robot, and it does not continue by itself.",
    "Look at the person and the sensors, then reset the limit on the page *System* or over REST.",
)
SPECIFICATIONS_UNAVAILABLE: Final = AlertType(
    AlertCategory.SYSTEM,
    "specificationDatabaseUnavailable",
    Severity.MEDIUM,
    "Device",
    "The specification database does not answer; only Tasks with complete parameters can be shown.",
    "Start the database, or correct HANDOVER_SPECIFICATION_URL.",
)
SPECIFICATIONS_NOT_WRITTEN: Final = AlertType(
    AlertCategory.SYSTEM,
    "specificationDatabaseNotWritten",
    Severity.HIGH,
    "Device",
    "The orchestrator cannot write the specification database; Tasks whose specification it holds wait.",
    "Start the database, or correct HANDOVER_SPECIFICATION_URL; the Tasks are then posted by themselves.",
)
CERTIFICATE_EXPIRES: Final = AlertType(
    AlertCategory.SYSTEM,
    "certificateExpires",
    Severity.HIGH,
    "Device",
    "The certificate of a server expires within a week, or has expired.",
    "Renew it with `handover secure renew`, or replace the file; servers load it by themselves.",
)
CERTIFICATE_NOT_LOADED: Final = AlertType(
    AlertCategory.SYSTEM,
    "certificateNotLoaded",
    Severity.HIGH,
    "Device",
    "The file of a server's certificate has changed and cannot be used; the former certificate stays in use.",
    "Correct the certificate and its key; servers load them by themselves.",
)
SUBSCRIPTION_CHANGED: Final = AlertType(
    AlertCategory.SYSTEM,
    "subscriptionChanged",
    Severity.HIGH,
    "Device",
    "Somebody changed or deleted a subscription of a service; the service has restored it.",
    "Find out who or what did: the audit log of the broker names accounts.",
)
SERVICE_RESTARTED: Final = AlertType(
    AlertCategory.SYSTEM,
    "serviceRestarted",
    Severity.HIGH,
    "Device",
    "A service did not answer although it worked, and was restarted by the watchdog.",
    "Look at the work of the service, and report its log to its maintainers.",
)
WRITE_FAILED: Final = AlertType(
    AlertCategory.SYSTEM,
    "writeFailed",
    Severity.HIGH,
    "Device",
    "The broker failed three times at a write of a service, which is not repeated.",
    "Look at the log of the broker; the entity is written again with its next change.",
)
DELETION_REFUSED: Final = AlertType(
    AlertCategory.SYSTEM,
    "deletionRefused",
    Severity.HIGH,
    "HumanState",
    "The broker cannot delete data of a person who does not allow them there.",
    "Delete what the Alert names in the broker, or in the service that keeps its history.",
)
ROS_PROBLEM: Final = AlertType(
    AlertCategory.ROS,
    None,
    Severity.MEDIUM,
    "Device",
    "A rule of the ROS mapping has a problem that lasts, for example a missing topic or type.",
    "Follow the description of the Alert; it names the rule.",
)

CATALOGUE: Final = (
    GLOVE_SILENT,
    CALIBRATION_NEEDED,
    DEVICE_ANOMALY,
    DEVICE_CERTIFICATE_EXPIRES,
    ROBOT_STOPPED_BY_LIMIT,
    UNKNOWN_GESTURE,
    TASK_NOT_ACCEPTED,
    TASK_PAST_DUE,
    TASK_PERFORMER_LOST,
    TASK_LOST,
    TASK_UNREADABLE,
    PROCESS_FAILED,
    PROCESS_INCIDENT,
    ENTITY_FILTER_REFUSED,
    SPECIFICATIONS_UNAVAILABLE,
    SPECIFICATIONS_NOT_WRITTEN,
    CERTIFICATE_EXPIRES,
    CERTIFICATE_NOT_LOADED,
    SUBSCRIPTION_CHANGED,
    SERVICE_RESTARTED,
    WRITE_FAILED,
    DELETION_REFUSED,
    ROS_PROBLEM,
)


def as_markdown() -> str:
    """Return the catalogue as a table in Markdown."""
    lines = [
        "| Category | Subcategory | Severity | alertSource | Raised when | What to do |",
        "|---|---|---|---|---|---|",
    ]
    for kind in CATALOGUE:
        sub_category = f"`{kind.sub_category}`" if kind.sub_category else "–"
        cells = (
            f"`{kind.category}`",
            sub_category,
            kind.severity.value,
            kind.source,
            kind.meaning,
            kind.action,
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
