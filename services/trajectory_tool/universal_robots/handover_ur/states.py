"""The states of a controller by name, as RTDE and the dashboard report them."""

from enum import IntEnum


class RobotMode(IntEnum):
    """`robot_mode`."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class UrSafetyStatus(IntEnum):
    """`safety_status`."""

    UNKNOWN = 0
    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    VALIDATE_JOINT_ID = 10
    UNDEFINED_SAFETY_MODE = 11
    AUTOMATIC_MODE_SAFEGUARD_STOP = 12
    SYSTEM_THREE_POSITION_ENABLING_STOP = 13


class RuntimeState(IntEnum):
    """`runtime_state`: the state of the running program."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class ProgramState(IntEnum):
    """What our program on the controller writes to its state register."""

    ABSENT = 0
    READY = 1
    SERVOING = 2
    ENDED_BY_WATCHDOG = 3


class ExchangeMode(IntEnum):
    """What our program on the controller should do; the driver writes it to the mode register."""

    END = 0
    HOLD = 1
    SERVO = 2


MAY_MOVE = frozenset({UrSafetyStatus.NORMAL, UrSafetyStatus.REDUCED})

HEARTBEAT_REGISTER, MODE_REGISTER = 24, 25
TARGET_REGISTER = 24
PROGRAM_STATE_REGISTER, PROGRAM_ID_REGISTER = 24, 25
"""General-purpose registers 24 to 47 are for RTDE clients; 0 to 23 belong to fieldbuses."""


def robot_mode(value: float) -> RobotMode:
    """Return the mode; a value of a later software version counts as disconnected."""
    try:
        return RobotMode(int(value))
    except ValueError:
        return RobotMode.DISCONNECTED


def safety_status(value: float) -> UrSafetyStatus:
    """Return the status; a value of a later software version counts as unknown, in which nothing moves."""
    try:
        return UrSafetyStatus(int(value))
    except ValueError:
        return UrSafetyStatus.UNKNOWN
