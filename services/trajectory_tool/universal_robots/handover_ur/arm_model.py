"""Whether the arm at a controller is the one that the motions are planned for.

A plan for another arm leads the tool elsewhere, by up to some decimetres. Handover knows the models that it
ships; the URDF of somebody else may have any name, so a setting says what its controller must report.
"""

import re

from handover.messages import Message, message

ANY = "any"
_NAME = re.compile(r"UR(\d+)(e?)", re.IGNORECASE)
_SOFTWARE = re.compile(r"URSoftware (\d+)\.")
E_SERIES_SOFTWARE = 5


def expected_model(robot_model: str, setting: str | None) -> str | None:
    """Return what "get robot model" of the dashboard must answer, such as UR5; None where all are accepted.

    The controller of a UR5e answers UR5.
    """
    if setting is not None:
        return None if setting.lower() == ANY else setting
    name = _NAME.fullmatch(robot_model)
    return None if name is None else f"UR{name[1]}"


def other_model(robot: str, expected: str, reported: str) -> Message | None:
    """Return the fault of an arm that is not the expected one; None if it is."""
    if reported.upper() == expected.upper():
        return None
    return message(
        "robot.ur_other_model",
        "the controller says that its arm is a {reported}, and motions of {robot} are planned for a "
        "{expected}; choose the model of the arm, or name the expected one in the setting controller_model",
        reported=reported,
        robot=robot,
        expected=expected,
    )


def other_series(robot_model: str, software: str) -> str | None:
    """Return a warning where the series differs: the links of a UR10 and a UR10e are not equally long."""
    name, version = _NAME.fullmatch(robot_model), _SOFTWARE.match(software)
    if name is None or version is None:
        return None
    is_e_series = int(version[1]) >= E_SERIES_SOFTWARE
    if is_e_series == bool(name[2]):
        return None
    series = ("e-Series", "CB3 series")
    planned, reported = series if name[2] else series[::-1]
    return f"motions are planned for an arm of the {planned}, and the controller is of the {reported}"
