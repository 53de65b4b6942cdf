"""The enumerations of states: Task, requested action, outcome, device, cell, Alert and measurement."""

from enum import StrEnum


class TaskStatus(StrEnum):
    """The status of a Task or a Process; the last two are final."""

    PENDING = "pending"
    ASSIGNED = "assigned"
    IN_PROGRESS = "inProgress"
    PAUSED = "paused"
    COMPLETED = "completed"
    FAILED = "failed"


class RequestedStatus(StrEnum):
    """The requested action on a Task; its performer then changes `status`."""

    PAUSED = "paused"
    IN_PROGRESS = "inProgress"
    CANCELLED = "cancelled"


class Outcome(StrEnum):
    """The `outcome` in the outputParameters of a person's Task; `ok` if it is missing."""

    OK = "ok"
    NOT_GOOD = "notGood"
    PROBLEM = "problem"


class DeviceState(StrEnum):
    """The state of a device."""

    OK = "ok"
    IDLE = "idle"
    BUSY = "busy"
    PAUSED = "paused"
    CHARGING = "charging"
    OUT_OF_BATTERY = "outOfBattery"
    FOR_MAINTENANCE = "forMaintenance"
    ERROR = "error"


class CellState(StrEnum):
    """The state of a cell: whether its orchestrator runs, or was stopped by a person."""

    RUNNING = "running"
    STOPPED = "stopped"


class Severity(StrEnum):
    """The severity of an Alert."""

    INFORMATIONAL = "informational"
    LOW = "low"
    MEDIUM = "medium"
    HIGH = "high"
    CRITICAL = "critical"


class AlertState(StrEnum):
    """The state of an Alert, after ISA-18.2."""

    NEW = "new"
    ACKNOWLEDGED = "acknowledged"
    SHELVED = "shelved"
    RETURNED_TO_NORMAL = "returnedToNormal"


class AlertPriority(StrEnum):
    """The urgency of a response to an Alert."""

    LOW = "low"
    MEDIUM = "medium"
    HIGH = "high"
    CRITICAL = "critical"


class MeasurementStatus(StrEnum):
    """Whether a value of a body signal may be used; only a `valid` one may raise a speed limit."""

    VALID = "valid"
    STALE = "stale"
    IMPLAUSIBLE = "implausible"
