"""Pinches: the fingers find room on both sides of the piece between them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_robots.perception.depth_image import Array
from handover_robots.perception.grasps import Fingers
from handover_robots.perception.pinches import CELL_M, best_pinch

FINGERS = Fingers(opening=0.08, thickness=0.015, width=0.021, length=0.05, palm=(0.2, 0.07, 0.06))


def plate(x: float, y: float, width: float, depth: float) -> Array:
    """Return points all over a rectangle around (x, y)."""
    along = np.arange(-width / 2, width / 2, 0.001) + x
    across = np.arange(-depth / 2, depth / 2, 0.001) + y
    return np.stack(np.meshgrid(along, across), axis=-1).reshape(-1, 2)


def glove() -> Array:
    """Return a palm with four fingers side by side, and a thumb to the right."""
    fingers = [plate(x, 0.09, 0.019, 0.08) for x in (-0.03, -0.01, 0.01, 0.03)]
    return np.vstack([plate(0.0, 0.0, 0.08, 0.1), plate(0.075, 0.0, 0.07, 0.02), *fingers])


def test_of_a_glove_the_thumb_is_pinched_across() -> None:
    pinch = best_pinch(glove(), FINGERS)
    assert pinch is not None
    x, y = pinch.place
    assert 0.05 < x < 0.11
    assert y == pytest.approx(0.0, abs=0.005)
    assert abs(math.sin(pinch.closing_rad)) == pytest.approx(1.0, abs=0.1)
    assert pinch.width_m == pytest.approx(0.02, abs=0.008)


def test_a_large_disc_has_no_pinch_but_a_square_has_its_corners() -> None:
    square = plate(0.0, 0.0, 0.8, 0.8)
    assert best_pinch(square[np.hypot(*square.T) < 0.4], FINGERS) is None
    corner = best_pinch(plate(0.0, 0.0, 0.2, 0.2), FINGERS)
    assert corner is not None
    assert math.hypot(*corner.place) > 0.11
    assert best_pinch(np.empty((0, 2)), FINGERS) is None


PATCHES = st.lists(
    st.tuples(*[st.floats(-0.15, 0.15)] * 2, *[st.floats(0.01, 0.12)] * 2), min_size=1, max_size=6
)


@given(PATCHES)
@settings(max_examples=40, deadline=None)
def test_the_opened_fingers_touch_nothing_at_a_pinch(
    patches: list[tuple[float, float, float, float]],
) -> None:
    points = np.vstack([plate(*patch) for patch in patches])
    pinch = best_pinch(points, FINGERS)
    if pinch is None:
        return
    c, s = math.cos(pinch.closing_rad), math.sin(pinch.closing_rad)
    local = (points - np.array(pinch.place)) @ np.array([[c, -s], [s, c]])
    is_beside = np.abs(local[:, 1]) < FINGERS.width / 2 - CELL_M
    reach = np.abs(local[:, 0])
    half = FINGERS.opening / 2
    assert not (is_beside & (reach > half) & (reach < half + FINGERS.thickness - CELL_M)).any()
    assert (is_beside & (reach < half)).any()
