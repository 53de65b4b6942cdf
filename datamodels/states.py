"""The words that a state may be: of a Task, a device, an alarm, and of what is asked of a Task."""

from enum import StrEnum


class TaskStatus(StrEnum):
    """How far a Task or a Process is; the last two are final."""

    PENDING = "pending"
    ASSIGNED = "assigned"
    IN_PROGRESS = "inProgress"
    PAUSED = "paused"
    COMPLETED = "completed"
    FAILED = "failed"


class RequestedStatus(StrEnum):
    """What somebody asks of a Task that is under way; its performer answers by moving `status`."""

    PAUSED = "paused"
    IN_PROGRESS = "inProgress"
    CANCELLED = "cancelled"


class Outcome(StrEnum):
    """What a person answers to a Task that asks something of them: `outcome` in its outputParameters.

    A Task without an outcome was answered `ok`.
    """

    OK = "ok"
    NOT_GOOD = "notGood"
    PROBLEM = "problem"


class DeviceState(StrEnum):
    """How a device is."""

    OK = "ok"
    IDLE = "idle"
    BUSY = "busy"
    PAUSED = "paused"
    CHARGING = "charging"
    OUT_OF_BATTERY = "outOfBattery"
    FOR_MAINTENANCE = "forMaintenance"
    ERROR = "error"


class Severity(StrEnum):
    """How grave an Alert is."""

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
    """How soon a person must respond to an Alert."""

    LOW = "low"
    MEDIUM = "medium"
    HIGH = "high"
    CRITICAL = "critical"
