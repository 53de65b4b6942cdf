"""Finger states: straight, between or bent, from the value of the bend sensor.

A finger is straight (0) above its upper threshold, bent (2) below its lower one, and between (1)
otherwise; an inverted finger is straight below and bent above. (Machines 2022, 10, 957, section 3.2.)
"""

from collections.abc import Sequence

from handover_gloves.recognition.thresholds import Thresholds

STRAIGHT, BETWEEN, BENT = "0", "1", "2"


def finger_states(bend: Sequence[float], thresholds: Thresholds) -> str:
    """Return the states of the five fingers, thumb first, such as `"02222"`.

    `bend` holds five raw sensor values in the same order; higher is straighter, except of inverted fingers.
    """
    return "".join(
        [
            STRAIGHT
            if threshold.straight_margin(value) > 0
            else BENT
            if threshold.bent_margin(value) > 0
            else BETWEEN
            for value, threshold in zip(bend, thresholds.fingers, strict=True)
        ]
    )
