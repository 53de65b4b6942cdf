"""Gloves are known from the file, by declaration and by hello; their thresholds survive a restart."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import Engine

from handover.errors import Problem
from services.gesture_controller.configuration import Configuration, built_in, parse
from services.gesture_controller.frames import Hello
from services.gesture_controller.glove import Glove
from services.gesture_controller.glove_store import GloveStore
from services.gesture_controller.gloves import Gloves, TooManyGloves
from services.gesture_controller.settings import ControllerSettings
from services.gesture_controller.thresholds import Threshold

Open = Callable[..., Gloves]


@pytest.fixture
def open_gloves(tmp_path: Path, database: Engine, notebook: Any) -> Open:
    """Open the gloves of a data directory, as a start of the controller does."""

    def begin(
        site: Configuration | None = None, adopted: Callable[[Glove], None] = lambda _: None, **overrides: Any
    ) -> Gloves:
        settings = ControllerSettings.load(data_dir=tmp_path, **overrides)
        return Gloves(settings, site or built_in(), GloveStore(database), notebook, adopted)

    return begin


async def test_thresholds_survive_a_restart_and_can_be_taken_back(open_gloves: Open) -> None:
    gloves = open_gloves()
    glove = gloves.named("glove-1")
    await gloves.set_thresholds(glove, {"ring": {"upper": 700, "lower": 600}})
    await gloves.set_thresholds(glove, {"thumb": {"upper": 500, "lower": 400}})
    gloves = open_gloves()
    glove = gloves.named("glove-1")
    assert glove.senses.thresholds.fingers[0] == Threshold(500, 400)
    assert glove.senses.thresholds.fingers[3] == Threshold(700, 600)
    await gloves.restore(glove)
    assert glove.senses.thresholds.fingers[0] == Threshold(1000, 800)
    assert glove.senses.thresholds.fingers[3] == Threshold(700, 600)
    gloves = open_gloves()
    await gloves.restore(gloves.named("glove-1"))
    assert gloves.named("glove-1").senses.thresholds.fingers[0] == Threshold(500, 400)


async def test_wrong_thresholds_change_nothing(open_gloves: Open) -> None:
    gloves = open_gloves()
    glove = gloves.named("glove-1")
    before = glove.senses.thresholds
    with pytest.raises(Problem, match="ring: the lower threshold 900 is above") as refused:
        await gloves.set_thresholds(glove, {"thumb": {"upper": 999}, "ring": {"upper": 800, "lower": 900}})
    assert refused.value.status == 422
    assert glove.senses.thresholds == before == open_gloves().named("glove-1").senses.thresholds
    with pytest.raises(Problem, match="were never changed"):
        await gloves.restore(glove)


async def test_a_calibration_is_kept(open_gloves: Open) -> None:
    gloves = open_gloves()
    await gloves.calibrate(gloves.named("glove-1"), [[300.0] * 5] * 20, [[700.0] * 5] * 20)
    assert open_gloves().named("glove-1").senses.thresholds.fingers[2] == Threshold(540, 500)


async def test_a_calibration_that_fails_names_the_finger_and_changes_nothing(open_gloves: Open) -> None:
    gloves = open_gloves()
    glove = gloves.named("glove-1")
    before = glove.senses.thresholds
    with pytest.raises(Problem, match="thumb: the sensor does not rise"):
        await gloves.calibrate(glove, [[300.0] * 5] * 20, [[300.0, 700, 700, 700, 700]] * 20)
    assert glove.senses.thresholds == before


async def test_a_declared_glove_is_known_after_a_restart(open_gloves: Open) -> None:
    declared, is_new = await open_gloves().declare("glove-2", "left", "ben")
    assert is_new
    assert (declared.hand, declared.person) == ("left", "ben")
    gloves = open_gloves()
    again, is_new = await gloves.declare("glove-2", None, None)
    assert not is_new
    assert (again.hand, again.person) == ("left", "ben")


async def test_a_declaration_that_cannot_be_is_refused(open_gloves: Open) -> None:
    gloves = open_gloves(max_gloves=2)
    for name, hand, person, status, words in (
        ("a b", None, None, 422, "cannot be called"),
        ("glove-1", "left", None, 409, "is the right glove of operator-1"),
        ("glove-2", None, "operator-1", 409, "operator-1 wears glove-1"),
    ):
        with pytest.raises(Problem, match=words) as refused:
            await gloves.declare(name, hand, person)
        assert refused.value.status == status
    await gloves.declare("glove-2", None, None)
    with pytest.raises(Problem, match="2 gloves at most"):
        await gloves.declare("glove-3", None, None)


def test_an_unknown_glove_is_a_404_that_names_the_known(open_gloves: Open) -> None:
    with pytest.raises(Problem, match='there is no glove "glove-9"; known: glove-1') as missing:
        open_gloves().named("glove-9")
    assert missing.value.status == 404


def test_every_glove_is_adopted_once(open_gloves: Open) -> None:
    adopted: list[str] = []
    gloves = open_gloves(
        parse("gloves: {left-1: {hand: left}, right-1: {}}"), lambda glove: adopted.append(glove.name)
    )
    link: Any = object()
    for name in ("left-1", "new", "new"):
        gloves.connect(Hello(name), link, 1.0)
    assert adopted == ["left-1", "right-1", "new"]
    assert [glove.name for glove in gloves] == adopted


def test_the_gloves_of_the_file_are_known_even_if_they_are_many(open_gloves: Open) -> None:
    gloves = open_gloves(parse("gloves: {a: {}, b: {}, c: {}}"), max_gloves=2)
    assert len(list(gloves)) == 3
    with pytest.raises(TooManyGloves):
        gloves.connect(Hello("d"), object(), 1.0)  # type: ignore[arg-type]


def test_a_person_with_own_gestures_shows_them_with_their_glove(open_gloves: Open) -> None:
    site = parse("persons: {anna: {3: Horns, 8: Thumbs up}}\ngloves: {g: {person: anna}, h: }")
    gloves = open_gloves(site)
    assert gloves.named("g").commands.gestures[3] == "Horns"
    assert gloves.named("h").commands.gestures[3] == "Thumbs up"
