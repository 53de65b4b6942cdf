"""What is said to the wearer names fingers and which way they go."""

from services.gesture_controller import wording


def test_the_fingers_that_differ_are_named_thumb_first() -> None:
    assert wording.differing("22202", "02222") == ["thumb", "ring"]
    assert wording.differing("12220", "02220") == ["thumb"]
    assert wording.differing("02222", "02222") == []


def test_a_finger_is_told_which_way_to_go() -> None:
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
        "text": "Ring straight is not the gesture this Task asks for: "
        "stretch your thumb, bend your ring finger.",
    }
    assert wording.nothing_to_do("glove-1", connected=True).as_dict() == {
        "key": "nothingToDo",
        "values": {},
        "text": "No Task for you at the moment.",
    }
