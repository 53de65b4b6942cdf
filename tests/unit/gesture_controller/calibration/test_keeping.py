"""Drift outlives the controller, is written seldom, and belongs to the fit that it was followed from."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from sqlalchemy import Engine

from services.gesture_controller.calibration.drift import Drift
from services.gesture_controller.calibration.keeping import KEEP_FROM, Keeping
from services.gesture_controller.calibration.logbook import Logbook
from services.gesture_controller.configuration import built_in
from services.gesture_controller.glove_store import GloveStore
from services.gesture_controller.gloves import Gloves
from services.gesture_controller.people.people import People
from services.gesture_controller.people.store import PeopleStore
from services.gesture_controller.settings import ControllerSettings

FIST, OPEN = [[300.0] * 5] * 20, [[700.0] * 5] * 20
Start = Callable[[], tuple[Gloves, Keeping]]


@pytest.fixture
def start(database: Engine, notebook: Any) -> Start:
    """Start a controller's gloves anew."""

    def begin() -> tuple[Gloves, Keeping]:
        people = People(built_in(), PeopleStore(database))
        gloves = Gloves(ControllerSettings(), GloveStore(database), people, notebook, lambda _: None)
        return gloves, Keeping(Logbook(database), gloves)

    return begin


def drift(gloves: Gloves, index: float, wants: str | None = None) -> None:
    """Let the index finger of glove-1 have drifted by so much of its span."""
    glove = gloves.named("glove-1")
    glove.sight = replace(glove.sight, drift=Drift((0.0, 400 * index, 0.0, 0.0, 0.0), wants))


def kept(gloves: Gloves) -> float:
    """By how much of its span the index finger of glove-1 has drifted."""
    return gloves.named("glove-1").sight.drift.offsets[1] / 400


async def test_what_moved_far_enough_is_kept_at_once_and_the_rest_at_the_end(start: Start) -> None:
    gloves, keeping = start()
    await gloves.calibrate(gloves.named("glove-1"), FIST, OPEN)
    drift(gloves, 0.1)
    await keeping.keep()
    drift(gloves, 0.1 + 0.9 * KEEP_FROM)
    await keeping.keep()
    assert kept(start()[0]) == pytest.approx(0.1), "it is written seldom"
    await keeping.keep(least=0.0)
    assert kept(start()[0]) == pytest.approx(0.1 + 0.9 * KEEP_FROM)


async def test_that_a_calibration_is_wanted_is_kept_too(start: Start) -> None:
    gloves, keeping = start()
    await gloves.calibrate(gloves.named("glove-1"), FIST, OPEN)
    drift(gloves, 0.0, "the level of the index jumped by 40% of its span")
    await keeping.keep()
    again = start()[0].named("glove-1")
    assert again.sight.drift.wants_calibration == "the level of the index jumped by 40% of its span"


async def test_drift_ends_with_the_fit_that_it_belongs_to(start: Start) -> None:
    gloves, keeping = start()
    glove = gloves.named("glove-1")
    await gloves.calibrate(glove, FIST, OPEN)
    drift(gloves, 0.1)
    await keeping.keep()
    await gloves.calibrate(glove, FIST, OPEN)
    await keeping.keep()
    assert kept(start()[0]) == 0


async def test_drift_is_that_of_who_wears_the_glove(start: Start) -> None:
    gloves, keeping = start()
    glove = gloves.named("glove-1")
    await gloves.wear(glove, "anna")
    await gloves.calibrate(glove, FIST, OPEN)
    drift(gloves, 0.1)
    await keeping.keep()
    await gloves.wear(glove, "ben")
    await keeping.keep()
    assert kept(start()[0]) == 0
    gloves, _ = start()
    await gloves.wear(gloves.named("glove-1"), "anna")
    assert kept(start()[0]) == pytest.approx(0.1)
