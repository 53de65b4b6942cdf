"""Why an arm cannot move, and the remedy, for each state of its controller."""

from handover.messages import Message, message
from handover_ur.shared_memory import Report
from handover_ur.states import (
    MAY_MOVE,
    RobotMode,
    UrSafetyStatus,
    robot_mode,
    safety_status,
)

MIN_SPEED_FRACTION = 0.01
EMERGENCY_STOPS = frozenset({UrSafetyStatus.SYSTEM_EMERGENCY_STOP, UrSafetyStatus.ROBOT_EMERGENCY_STOP})
SAFEGUARD_STOPS = frozenset({UrSafetyStatus.SAFEGUARD_STOP, UrSafetyStatus.AUTOMATIC_MODE_SAFEGUARD_STOP})


def fault_of(report: Report, now_s: float, silence_s: float, host: str) -> Message | None:
    """Return why the arm cannot move; None if it can. `now_s` is on the monotonic clock.

    A controller whose last report is older than `silence_s` is not connected.
    """
    if not is_connected(report, now_s, silence_s):
        return message(
            "robot.ur_unreachable",
            "the controller {host} is not connected: {reason}; check its power, the network and the "
            "setting host",
            host=host,
            reason=why_silent(report, now_s),
        )
    return _safety_fault(safety_status(report.safety_status)) or _mode_fault(report)


def is_connected(report: Report, now_s: float, silence_s: float) -> bool:
    """Return whether the controller reports; `now_s` is on the monotonic clock."""
    return report.is_connected and now_s - report.stamp_s <= silence_s


def why_silent(report: Report, now_s: float) -> str:
    """Return why the controller is not connected."""
    if report.reason:
        return report.reason
    if report.stamp_s == 0:
        return message("robot.ur_no_report", "it has not reported yet")
    return message(
        "robot.ur_old_report", "its last report is {age} s old", age=round(now_s - report.stamp_s, 1)
    )


def _safety_fault(status: UrSafetyStatus) -> Message | None:
    if status in MAY_MOVE:
        return None
    if status is UrSafetyStatus.PROTECTIVE_STOP:
        return message(
            "robot.ur_protective_stop",
            "the arm is in a protective stop; remove the cause, then unlock the arm at the teach pendant",
        )
    if status in EMERGENCY_STOPS:
        return message(
            "robot.ur_emergency_stop",
            "an emergency stop is active ({state}); release its button when the cell is safe, then power on "
            "the arm at the teach pendant",
            state=status.name,
        )
    if status in SAFEGUARD_STOPS:
        return message(
            "robot.ur_safeguard_stop",
            "a safeguard stop is active ({state}); leave the safeguarded space and reset the safeguard",
            state=status.name,
        )
    return message(
        "robot.ur_safety_state",
        "the safety system of the controller reports {state}; follow the instructions on the teach pendant",
        state=status.name,
    )


def _mode_fault(report: Report) -> Message | None:
    mode = robot_mode(report.robot_mode)
    if mode is RobotMode.RUNNING:
        return None
    if mode is RobotMode.IDLE:
        return message(
            "robot.ur_brakes_closed",
            "the brakes of the arm are closed; release them at the teach pendant or with POST "
            "…/controller/brake-release",
        )
    if mode is RobotMode.POWER_OFF:
        return message(
            "robot.ur_powered_off",
            "the arm is powered off; power it on at the teach pendant or with POST …/controller/power-on",
        )
    return message(
        "robot.ur_mode",
        "the arm is in the mode {mode}; bring it to RUNNING at the teach pendant",
        mode=mode.name,
    )
