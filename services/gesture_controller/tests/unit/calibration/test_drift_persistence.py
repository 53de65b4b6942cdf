"""Drift outlives the controller, is written seldom, and belongs to the fit that it was followed from."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from sqlalchemy import Engine

from handover_gloves.calibration.calibration_store import CalibrationStore
from handover_gloves.calibration.drift_persistence import MIN_SAVED_CHANGE, DriftPersistence
from handover_gloves.calibration.glove_store import GloveStore
from handover_gloves.configuration.gestures_file import built_in
from handover_gloves.connection.admission import TokenStore
from handover_gloves.connection.glove_registry import GloveRegistry
from handover_gloves.people.people import People
from handover_gloves.people.store import PeopleStore
from handover_gloves.people.study_condition_store import StudyConditionStore
from handover_gloves.recognition.drift import Drift
from handover_gloves.settings import ControllerSettings

FIST, OPEN = [[300.0] * 5] * 20, [[700.0] * 5] * 20
Start = Callable[[], tuple[GloveRegistry, DriftPersistence]]


@pytest.fixture
def start(database: Engine, listener_log: Any) -> Start:
    """Start the gloves of a controller again."""

    def begin() -> tuple[GloveRegistry, DriftPersistence]:
        people = People(built_in(), PeopleStore(database))
        gloves = GloveRegistry(
            ControllerSettings(),
            store=GloveStore(database),
            tokens=TokenStore(database),
            people=people,
            conditions=StudyConditionStore(database),
            listener=listener_log,
            adopted=lambda _: None,
        )
        return gloves, DriftPersistence(CalibrationStore(database), gloves.known, gloves.records)

    return begin


def drift(gloves: GloveRegistry, index: float, wants: str | None = None) -> None:
    """Let the index finger of glove-1 have drifted by so much of its span."""
    glove = gloves.known.named("glove-1")
    glove.reader.state = replace(glove.reader.state, drift=Drift((0.0, 400 * index, 0.0, 0.0, 0.0), wants))


def kept(gloves: GloveRegistry) -> float:
    """By how much of its span the index finger of glove-1 has drifted."""
    return gloves.known.named("glove-1").reader.state.drift.offsets[1] / 400


async def test_what_moved_far_enough_is_kept_at_once_and_the_rest_at_the_end(start: Start) -> None:
    gloves, persistence = start()
    await gloves.fits.calibrate(gloves.known.named("glove-1"), FIST, OPEN)
    drift(gloves, 0.1)
    await persistence.save()
    drift(gloves, 0.1 + 0.9 * MIN_SAVED_CHANGE)
    await persistence.save()
    assert kept(start()[0]) == pytest.approx(0.1), "it is written seldom"
    await persistence.save(min_change=0.0)
    assert kept(start()[0]) == pytest.approx(0.1 + 0.9 * MIN_SAVED_CHANGE)


async def test_that_a_calibration_is_wanted_is_kept_too(start: Start) -> None:
    gloves, persistence = start()
    await gloves.fits.calibrate(gloves.known.named("glove-1"), FIST, OPEN)
    drift(gloves, 0.0, "the level of the index jumped by 40% of its span")
    await persistence.save()
    again = start()[0].known.named("glove-1")
    assert again.reader.state.drift.wants_calibration == "the level of the index jumped by 40% of its span"


async def test_drift_ends_with_the_fit_that_it_belongs_to(start: Start) -> None:
    gloves, persistence = start()
    glove = gloves.known.named("glove-1")
    await gloves.fits.calibrate(glove, FIST, OPEN)
    drift(gloves, 0.1)
    await persistence.save()
    await gloves.fits.calibrate(glove, FIST, OPEN)
    await persistence.save()
    assert kept(start()[0]) == 0


async def test_drift_is_that_of_who_wears_the_glove(start: Start) -> None:
    gloves, persistence = start()
    glove = gloves.known.named("glove-1")
    await gloves.wearers.wear(glove, "anna")
    await gloves.fits.calibrate(glove, FIST, OPEN)
    drift(gloves, 0.1)
    await persistence.save()
    await gloves.wearers.wear(glove, "ben")
    await persistence.save()
    assert kept(start()[0]) == 0
    gloves, _ = start()
    await gloves.wearers.wear(gloves.known.named("glove-1"), "anna")
    assert kept(start()[0]) == pytest.approx(0.1)
