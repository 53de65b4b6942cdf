"""The Alerts of all services: category, subcategory, severity and texts of each, in one place.

An integrator subscribes to Alerts by category and subcategory, and the page explains the subcategories that
it knows. `docs/reference/alerts.md` shows the same table. Rules of a ROS mapping define Alerts of their own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from handover.messages import Message, Parameter
from handover.messages import message as from_template
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
    descriptions: Mapping[str, str] = field(default_factory=dict, hash=False)
    """What its description may be: templates (as for `str.format`) by their codes."""

    def describe(self, code: str, /, **parameters: Parameter) -> Message:
        """Return the description of `code` with these parameters. Raises `KeyError` for others."""
        return from_template(code, self.descriptions[code], **parameters)


GLOVE_SILENT: Final = AlertType(
    AlertCategory.DEVICE,
    "gloveSilent",
    Severity.HIGH,
    "Device",
    "A glove sends no frames while a Task waits for its wearer; the Task is paused.",
    "Check that the glove is switched on, charged and in range, or complete the Task on the page.",
    {
        "alert.glove_silent": (
            "{glove} has sent nothing for {seconds} s in the middle of a Task, which is paused until "
            "it is back; check that it is switched on, charged and near, or complete the Task on the "
            "screen"
        ),
    },
)
CALIBRATION_NEEDED: Final = AlertType(
    AlertCategory.DEVICE,
    "calibrationNeeded",
    Severity.MEDIUM,
    "Device",
    "The values of a glove no longer match its calibration.",
    "Calibrate the glove, on its page or with `handover glove calibrate`.",
    {
        "alert.calibration_needed": (
            "{glove} should be calibrated again: {why}. Put it on as usual, make a fist and open the "
            "hand under Calibration on its page; Tasks can be completed on the screen meanwhile"
        ),
    },
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
    {
        "alert.task_overdue": 'No performer has accepted the Task "{task}" ({involved})',
        "alert.task_unclaimed": 'Nobody has claimed the Task "{task}" in time',
    },
)
TASK_PAST_DUE: Final = AlertType(
    AlertCategory.TASK,
    "taskPastDue",
    Severity.MEDIUM,
    "Task",
    "A Task has not ended at its due date, or a level of its escalation was reached.",
    "Complete the Task, or ask somebody else to.",
    {
        "alert.task_escalated_to": 'The Task "{task}" has not ended in time; it was escalated to {group}',
        "alert.task_escalated": (
            'The Task "{task}" has not ended in time; the escalation "{code}" was thrown'
        ),
        "alert.task_past_due": 'The Task "{task}" has not ended in time',
    },
)
TASK_PERFORMER_LOST: Final = AlertType(
    AlertCategory.TASK,
    "taskPerformerLost",
    Severity.HIGH,
    "Task",
    "The performer of a Task in progress has lost the lease of its Device: it was killed, paused or cut off.",
    "Look at the machine, and start the performer again; otherwise the process asks, retries or waits, as "
    "its definition says.",
    {
        "alert.task_performer_lost": (
            'The performer of the Task "{task}" ({holder}) does not answer any more; the Task is {status}'
        ),
    },
)
TASK_LOST: Final = AlertType(
    AlertCategory.TASK,
    "taskLost",
    Severity.HIGH,
    "Task",
    "The broker no longer has a Task that a performer had started.",
    "Check the state of the work, then cancel the process.",
    {
        "alert.task_lost": (
            'The broker no longer has the Task "{task}", which was {status}. Check the state of the '
            "work, then cancel the process {process}"
        ),
    },
)
TASK_UNREADABLE: Final = AlertType(
    AlertCategory.TASK,
    "taskUnreadable",
    Severity.HIGH,
    "Task",
    "A program has written a Task against the data model, for example an unknown status; the process waits.",
    "Correct the program that the Alert names, and let it write the Task again. With accounts, the audit log "
    "of the broker names the account that wrote it.",
    {
        "alert.task_unreadable": (
            'The Task "{task}" ({id}) waits: what {writer} has written breaks a rule: {rule}. '
            "Correct {writer} and write the Task again, or cancel the process {process}"
        ),
        "alert.task_unreadable_unknown": (
            'The Task "{task}" ({id}) waits: what a program without a lease has written breaks a '
            "rule: {rule}. Correct the program and write the Task again, or cancel the process "
            "{process}"
        ),
    },
)
PROCESS_FAILED: Final = AlertType(
    AlertCategory.PROCESS,
    "processFailed",
    Severity.HIGH,
    "Process",
    "A process ended by an error that its model does not catch.",
    "Remove the cause that the Alert names, then start a new process.",
    {
        "alert.process_failed": "The process {process} has failed: {reason}",
    },
)
PROCESS_INCIDENT: Final = AlertType(
    AlertCategory.PROCESS,
    "processIncident",
    Severity.HIGH,
    "Process",
    "A part of a process cannot continue: a Task failed, no condition holds, or a variable is missing. "
    "Other parts of the process continue.",
    "Remove the cause that the Alert names, then retry, skip or move it on the page.",
    {
        "alert.process_incident": "The process {process} waits for help at {element}: {reason}",
    },
)
ENTITY_FILTER_REFUSED: Final = AlertType(
    AlertCategory.PROCESS,
    "entityFilterRefused",
    Severity.HIGH,
    "ProcessDefinition",
    "The broker refuses the filter of an event that waits for entities, so the event never occurs.",
    "Correct the `q` or `idPattern` of `handover:on` and deploy the file again.",
    {
        "alert.entity_filter_refused": (
            'The event "{event}" never occurs: the broker refuses its filter (type {type}, q {q}): '
            "{why}. Correct the file and deploy it again"
        ),
    },
)
DEVICE_ANOMALY: Final = AlertType(
    AlertCategory.DEVICE,
    "deviceAnomaly",
    Severity.MEDIUM,
    "Device",
    "A value of a device is abnormal by a rule of the device gateway; the severity is that of the rule.",
    "Look at the device and at the chart of the value; correct the rule if the value is usual.",
    {
        "device.anomaly_limits": (
            "{device}: {name} is {measured}, beyond the limit {limit} (rule {rule}).{note}"
        ),
        "device.anomaly_rate": (
            "{device}: {name} changes by {measured} a second, more than {limit} (rule {rule}).{note}"
        ),
        "device.anomaly_z_score": (
            "{device}: {name} is {measured} standard deviations from its mean, more than {limit} "
            "(rule {rule}).{note}"
        ),
        "device.anomaly_silence": (
            "{device} has sent no {name} for more than {limit} s (rule {rule}).{note}"
        ),
        "device.anomaly_seasonal": (
            "{device}: {name} is {measured} standard deviations from what is usual at this time, "
            "more than {limit} (rule {rule}).{note}"
        ),
    },
)
DEVICE_CERTIFICATE_EXPIRES: Final = AlertType(
    AlertCategory.DEVICE,
    "deviceCertificateExpires",
    Severity.HIGH,
    "Device",
    "The client certificate of a device expires within a week, or has expired.",
    "Make a new one with `handover device certificate`, or on the page *Devices*, and copy it to the device.",
    {
        "device.certificate_expires": (
            "the client certificate of {device} is valid until {end} UTC; make a new one with "
            "`handover device certificate {device}` and copy it to the device"
        ),
    },
)
ROBOT_STOPPED_BY_LIMIT: Final = AlertType(
    AlertCategory.DEVICE,
    "robotStoppedByLimit",
    Severity.HIGH,
    "Device",
    "A limit for the protection of people has stopped a robot, and it does not continue by itself.",
    "Look at the person and the sensors, then reset the limit on the page of the robot or over REST.",
    {
        "robot.stopped_by_limit": "{robot} is stopped and does not continue by itself: {reason}",
    },
)
SPECIFICATIONS_UNAVAILABLE: Final = AlertType(
    AlertCategory.SYSTEM,
    "specificationDatabaseUnavailable",
    Severity.MEDIUM,
    "Device",
    "The specification database does not answer; only Tasks with complete parameters can be shown.",
    "Start the database, or correct HANDOVER_SPECIFICATION_URL.",
    {
        "alert.specifications_away": "{detail}. Only Tasks that say all themselves can be shown",
    },
)
SPECIFICATIONS_NOT_WRITTEN: Final = AlertType(
    AlertCategory.SYSTEM,
    "specificationDatabaseNotWritten",
    Severity.HIGH,
    "Device",
    "The orchestrator cannot write the specification database; Tasks whose specification it holds wait.",
    "Start the database, or correct HANDOVER_SPECIFICATION_URL; the Tasks are then posted by themselves.",
    {
        "alert.specifications_not_written": (
            "The specification database cannot be written: {why}. Tasks that need it wait and are "
            "posted when it is back; all others continue. Start it, or correct {setting}"
        ),
    },
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
    {
        "service.subscription_changed": (
            "somebody changed or deleted the subscription {subscription} of {service}; it is "
            "restored. The audit log of the broker names accounts; without accounts, look which "
            "program on this machine does it"
        ),
    },
)
SERVICE_RESTARTED: Final = AlertType(
    AlertCategory.SYSTEM,
    "serviceRestarted",
    Severity.HIGH,
    "Device",
    "A service did not answer although it worked, and was restarted by the watchdog.",
    "Look at the work of the service, and report its log to its maintainers.",
    {
        "service.restarted": (
            "{service} did not answer for {silent} s although it worked, and was restarted; look at "
            "its log, and report what it did before"
        ),
    },
)
WRITE_FAILED: Final = AlertType(
    AlertCategory.SYSTEM,
    "writeFailed",
    Severity.HIGH,
    "Device",
    "The broker failed three times at a write of a service, which is not repeated.",
    "Look at the log of the broker; the entity is written again with its next change.",
    {
        "alert.write_failed": (
            "The broker failed {times} times at the write of {key}, which stays there as it was: "
            "{why}. The log of the broker says more"
        ),
    },
)
DELETION_REFUSED: Final = AlertType(
    AlertCategory.SYSTEM,
    "deletionRefused",
    Severity.HIGH,
    "HumanState",
    "The broker cannot delete data of a person who does not allow them there.",
    "Delete what the Alert names in the broker, or in the service that keeps its history.",
    {
        "alert.entity_not_deleted": (
            "The broker refuses to delete {entity}, whose person does not allow it there: {why}. "
            "Delete it in the broker"
        ),
        "alert.history_not_deleted": (
            "The broker cannot delete the history of {entity}: {why}. Where it or a service beside "
            "it (such as Mintaka) has one, delete it there"
        ),
    },
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
        names = (f"`{kind.category}`", sub_category, kind.severity.value, kind.source)
        lines.append(f"| {' | '.join((*names, kind.meaning, kind.action))} |")
    return "\n".join(lines) + "\n"
