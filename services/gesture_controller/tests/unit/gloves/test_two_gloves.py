"""Composite gestures answer Tasks: two hands at once, or a sequence; the page shows what is next."""

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from handover.job import RequestedAction
from handover_gloves.gloves.glove_view import view_of
from handover_gloves.prompting.prompt import GesturePrompt
from handover_gloves.prompting.prompt_resolver import resolve_prompt
from handover_gloves.recognition.gestures import Shape
from handover_gloves.specifications.definition import Definition
from services.gesture_controller.tests.unit.gloves.conftest import SITE, Pair

OPEN, UP, HORNS, POINT, FIST = "00000", "02222", "20220", "20222", "22222"
Begin = Callable[..., GesturePrompt]
SITE_MINE = Shape("20000")


@pytest.fixture
def begin(pair: Pair, make_job: Callable[..., Any]) -> Begin:
    """Ask the right hand's glove for a gesture; `both`: the left one takes part."""

    def ask(gesture: str, *, both: bool = False) -> GesturePrompt:
        job = make_job("t1")
        asked = resolve_prompt(job.task, {"gesture": gesture}, Definition(), SITE.gestures, SITE.commands)
        prompt = GesturePrompt(asked, job, asyncio.get_running_loop().create_future())
        pair.right.responder.begin(prompt)
        if both:
            pair.right.responder.join(pair.left.responder)
        pair.right.responder.listen()
        return prompt

    return ask


def view(pair: Pair, hand: str = "right") -> dict[str, Any]:
    return view_of(pair.right if hand == "right" else pair.left, pair.now_s)


async def test_both_hands_answer_and_both_pages_show_what_to_do(pair: Pair, begin: Begin) -> None:
    prompt = begin("Both thumbs up", both=True)
    pair.show(OPEN, OPEN, 0.3)
    invitation = "Show with both hands: Thumbs up with the left, Thumbs up with the right."
    assert view(pair)["message"]["text"] == view(pair, "left")["message"]["text"] == invitation
    pair.show(OPEN, UP, 0.6)
    shown = view(pair)
    assert shown["message"]["text"] == "Right. Now your left hand as well: Thumbs up."
    assert [part["state"] for part in shown["task"]["parts"]] == ["now", "held"]
    assert view(pair, "left")["differs"] == ["index", "middle", "ring", "little"]
    pair.show(UP, UP, 0.6)
    assert view(pair, "left")["message"]["key"] == "holdOn"
    assert view(pair)["hold"]["heldMs"] == view(pair, "left")["hold"]["heldMs"] == 580
    assert not prompt.answer.done()
    pair.show(UP, UP, 1.0)
    assert prompt.answer.result().outputs() == {
        "gesture": "Both thumbs up",
        "commandId": 3,
        "heldMs": 1500,
        "by": "gesture",
        "outcome": "ok",
    }
    assert pair.left.responder.command is not None
    assert pair.right.responder.command is not None
    assert pair.left.responder.command[0] == pair.right.responder.command[0] == 3
    pair.right.responder.end()
    assert pair.left.responder.prompt is pair.left.responder.partner is pair.right.responder.partner is None
    assert pair.left.responder.free.is_set()


async def test_one_hand_alone_never_answers_for_both(pair: Pair, begin: Begin) -> None:
    prompt = begin("Both thumbs up", both=True)
    pair.show(OPEN, UP, 3)
    pair.show(UP, OPEN, 3)
    pair.show(HORNS, UP, 3)
    assert not prompt.answer.done()
    pair.show(OPEN, OPEN, 0.3)
    pair.show(UP, UP, 1.6)
    assert prompt.answer.done()


async def test_without_the_other_glove_the_page_says_so_and_the_screen_still_completes(
    pair: Pair, begin: Begin
) -> None:
    prompt = begin("Cross")
    pair.show(OPEN, OPEN, 0.2)
    assert view(pair)["message"]["text"].startswith(
        "Cross needs both hands. Also put on the left glove and assign it to anna"
    )
    pair.show(HORNS, FIST, 3)
    assert not prompt.answer.done()
    pair.show(OPEN, OPEN, 0.2)
    pair.right.responder.join(pair.left.responder)  # as the controller does when the other glove is there
    pair.show(HORNS, FIST, 1.6)
    assert prompt.answer.done()


async def test_a_hand_that_rested_in_its_part_must_begin_with_the_other(pair: Pair, begin: Begin) -> None:
    prompt = begin("Both thumbs up", both=True)
    pair.show(UP, OPEN, 3)
    pair.show(UP, UP, 3)
    assert not prompt.answer.done()
    assert (
        view(pair)["message"]["text"] == "Let go, then show Both thumbs up with both hands at the same time."
    )


async def test_while_either_glove_is_testing_paused_or_silent_nothing_answers(
    pair: Pair, begin: Begin
) -> None:
    prompt = begin("Both thumbs up", both=True)
    pair.left.switch(testing=True, filtering=None)
    pair.show(UP, UP, 2)
    pair.left.switch(testing=False, filtering=None)
    pair.left.pause()
    pair.right.pause()
    pair.left.resume()
    assert prompt.job.requested_action is RequestedAction.PAUSE
    pair.show(UP, UP, 2)
    pair.right.resume()
    assert prompt.job.requested_action is RequestedAction.RUN
    pair.show(None, UP, 2.2)
    assert prompt.job.requested_action is RequestedAction.PAUSE
    assert view(pair, "left")["lost"] is True
    assert not prompt.answer.done()
    pair.show(OPEN, OPEN, 0.2)
    pair.right.responder.listen()
    assert prompt.job.requested_action is RequestedAction.RUN
    pair.show(UP, UP, 1.6)
    assert prompt.answer.done()


async def test_a_sequence_answers_and_the_page_shows_the_next_gesture(pair: Pair, begin: Begin) -> None:
    prompt = begin("Wave off")
    pair.show(OPEN, OPEN, 0.2)
    shown = view(pair)
    assert shown["message"]["text"] == "Show Wave off. First: Point with index."
    assert (shown["task"]["code"], shown["hold"]["confirmMs"]) == (POINT, 500)
    pair.show(OPEN, POINT, 0.54)
    shown = view(pair)
    assert shown["message"]["text"] == "Right. Now: Horns."
    assert (shown["task"]["code"], shown["hold"]["confirmMs"]) == (HORNS, 1000)
    assert shown["task"]["parts"] == [
        {"gesture": "Point with index", "code": POINT, "hand": None, "state": "done"},
        {"gesture": "Horns", "code": HORNS, "hand": None, "state": "now"},
    ]
    pair.show(OPEN, OPEN, 1)
    pair.show(OPEN, HORNS, 0.8)
    assert view(pair)["message"]["key"] == "holdOn"
    pair.show(OPEN, HORNS, 0.3)
    assert prompt.answer.result().gesture == "Wave off"
    assert prompt.answer.result().held_ms >= 1500


async def test_a_part_alone_neither_answers_nor_gives_its_own_command(pair: Pair, begin: Begin) -> None:
    prompt = begin("Wave off")
    pair.right.switch(testing=None, filtering=False)
    pair.show(OPEN, HORNS, 5)
    assert not prompt.answer.done()
    assert pair.right.responder.command is None
    pair.show(OPEN, OPEN, 0.2)
    pair.show(OPEN, UP, 2)
    assert pair.right.responder.command is not None
    assert pair.right.responder.command[0] == 1


async def test_without_filtering_composed_gestures_are_commands_and_their_parts_are_not(pair: Pair) -> None:
    for glove in (pair.left, pair.right):
        glove.switch(testing=None, filtering=False)
    assert view(pair)["warning"]["text"].startswith("Filtering is off: every gesture with a command")
    pair.show(UP, UP, 3)
    assert [glove.responder.command and glove.responder.command[0] for glove in (pair.left, pair.right)] == [
        3,
        3,
    ]
    pair.show(OPEN, OPEN, 0.3)
    pair.show(OPEN, POINT, 0.6)
    pair.show(OPEN, HORNS, 3)
    assert pair.right.responder.command is not None
    assert pair.right.responder.command[0] == 4
    pair.show(OPEN, OPEN, 0.3)
    pair.show(UP, OPEN, 1.6)
    assert pair.left.responder.command is not None
    assert pair.left.responder.command[0] == 1
    pair.show(OPEN, OPEN, 0.3)
    pair.left.switch(testing=None, filtering=True)
    assert view(pair, "left")["warning"] is None


async def test_what_is_asked_stays_when_somebody_else_wears_the_glove(pair: Pair, begin: Begin) -> None:
    prompt = begin("Wave off")
    other = SITE.gestures.with_shapes({"Mine": SITE_MINE}).with_parts(prompt.spec.parts)
    pair.right.equip(other, SITE.commands)
    pair.show(OPEN, OPEN, 0.1)
    pair.show(OPEN, POINT, 0.6)
    pair.show(OPEN, HORNS, 1.1)
    assert prompt.answer.done()
