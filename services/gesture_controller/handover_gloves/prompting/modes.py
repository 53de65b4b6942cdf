"""The modes of a glove."""

from dataclasses import dataclass


@dataclass(slots=True)
class GloveModes:
    """Which gestures of a glove count."""

    filtering: bool
    """True: only the gesture that the Task asks for, and its other answers. False: commands as well."""
    testing: bool = False
    """True: nothing counts."""
    paused: bool = False
    """True: the wearer paused the work on the screen; nothing counts."""
