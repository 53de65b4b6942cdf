"""What is said to the wearer names fingers and which way they go."""

import inspect
import json
from itertools import product

import pytest

from handover_datamodels.states import Outcome
from handover_gloves.gloves import operator_messages as wording
from tests.kit.paths import REPOSITORY

WORDS = REPOSITORY / "webui/app/src/i18n"


def every_message() -> list[wording.OperatorMessage]:
    """Return a message of each kind that the controller can send for a task."""
    choices: dict[str, list[object]] = {
        "hand": ["left", "right"],
        "person": [None, "anna"],
        "shown": [None, "Horns"],
        "connected": [True, False],
        "outcome": [Outcome.NOT_GOOD, Outcome.PROBLEM],
        "hint": [wording.advice(["thumb"], "02222")],
        "confirm_in_ms": [1000.0],
    }
    functions = [one for _, one in inspect.getmembers(wording, inspect.isfunction)]
    made: list[wording.OperatorMessage] = []
    for function in functions:
        signature = inspect.signature(function)
        if signature.return_annotation is not wording.OperatorMessage:
            continue
        given = product(*(choices.get(name, ["Horns"]) for name in signature.parameters))
        made.extend(function(*values) for values in given)
    return made


def test_the_fingers_that_differ_are_named_thumb_first() -> None:
    assert wording.differing("22202", "02222") == ["thumb", "ring"]
    assert wording.differing("12220", "02220") == ["thumb"]
    assert wording.differing("02222", "02222") == []


def test_the_message_names_the_direction_of_a_finger() -> None:
    assert str(wording.advice(["ring"], "22202")) == "stretch your ring finger"
    assert str(wording.advice(["thumb"], "20222")) == "bend your thumb"
    both = wording.advice(["thumb", "ring"], "02222")
    assert str(both) == "stretch your thumb, bend your ring finger"
    assert str(wording.advice(["index", "middle", "ring"], "22222")) == (
        "bend your index finger, middle finger and ring finger"
    )


def test_the_time_left_is_said_in_seconds() -> None:
    assert wording.hold_on(1000).text == "Right. Hold it for another second to confirm."
    assert wording.hold_on(1500).text == "Right. Hold it for another 1.5 seconds to confirm."


def test_a_screen_can_say_it_in_its_own_language() -> None:
    hint = wording.advice(["thumb", "ring"], "02222")
    assert wording.wrong("Ring straight", hint).as_dict() == {
        "key": "wrong",
        "values": {"shown": "Ring straight", "stretch": ["thumb"], "bend": ["ring"]},
        "text": "That is Ring straight, not the requested gesture: "
        "stretch your thumb, bend your ring finger.",
    }
    assert wording.nothing_to_do("glove-1", connected=True).as_dict() == {
        "key": "nothingToDo",
        "values": {},
        "text": "No task for you.",
    }


@pytest.mark.parametrize("language", ["en", "de", "fi"])
def test_the_work_page_has_words_for_every_message(language: str) -> None:
    words = json.loads((WORDS / language / "work.json").read_text(encoding="utf-8"))
    known = set(words["message"]) | {"unfiltered"}
    assert words["unfiltered"]
    sent = {message.key for message in every_message()}
    assert {"answeredNotGood", "holdOnProblem", "wearBothLeft", "show"} <= sent
    assert sent - known == set()


def test_every_differing_finger_is_named_however_many_they_are() -> None:
    hint = wording.advice(wording.differing("20000", "02222"), "02222")
    named = wording.differs("Thumbs up", hint).values
    assert (named["stretch"], named["bend"]) == (["thumb"], ["index", "middle", "ring", "little"])
