"""The 21 gestures of M2O2P, their codes, and the commands they stand for."""

import pytest

from handover_gloves.recognition.gestures import (
    M2O2P_GESTURES,
    Commands,
    Gestures,
    Part,
    SequenceGesture,
    Shape,
    TwoHandGesture,
    WrongGesture,
    codes_in_use,
    default_commands,
    described,
    listed,
)


def test_there_are_21_gestures_with_a_code_each() -> None:
    assert len(M2O2P_GESTURES) == 21
    assert len(set(M2O2P_GESTURES.values())) == 21


def test_a_gesture_is_called_after_its_straight_fingers() -> None:
    fingers = ("thumb", "index", "middle", "ring", "little")
    for name, code in M2O2P_GESTURES.items():
        straight = {finger for finger, state in zip(fingers, code, strict=True) if state == "0"}
        if name == "Horns":
            assert straight == {"index", "little"}
        elif name == "Thumbs up":
            assert straight == {"thumb"}
        else:
            assert straight == {finger for finger in fingers if finger in name.lower()}, name


def test_every_gesture_has_one_command_by_default() -> None:
    commands = default_commands(Gestures(M2O2P_GESTURES))
    assert sorted(commands.ids.values()) == list(range(1, 22))
    assert set(commands.ids) == set(M2O2P_GESTURES)
    assert commands.gestures[3] == "Thumbs up"


def test_a_gesture_is_found_whatever_its_capitals() -> None:
    gestures = Gestures(M2O2P_GESTURES)
    assert gestures.find("thumbs UP") == "Thumbs up"
    assert gestures.find("Vulcan salute") is None


def test_a_misspelt_gesture_brings_up_the_one_meant() -> None:
    assert gestures_like("Thumb up") == 'did you mean "Thumbs up"'
    assert gestures_like("xyz").startswith("the gestures are Horns")


def gestures_like(name: str) -> str:
    return Gestures(M2O2P_GESTURES).like(name)


def test_a_persons_own_gesture_takes_the_place_of_the_maps() -> None:
    commands = Commands({1: "Horns", 2: "Thumbs up"}).with_own({1: "Ring straight"})
    assert commands.gestures == {1: "Ring straight", 2: "Thumbs up"}
    assert "Horns" not in commands.ids


def test_a_code_without_a_name_is_called_after_its_straight_fingers() -> None:
    own_words = {"Horns", "Thumbs up", "Point with index"}
    for name, code in M2O2P_GESTURES.items():
        assert described(code) == name or name in own_words
    assert (described("22222"), described("00000")) == ("Fist", "Open hand")
    assert described("20222") == "Index straight"


def test_two_gestures_are_composed_for_both_hands_or_in_turn() -> None:
    site = Gestures(M2O2P_GESTURES)
    gestures = site.with_shapes(
        {
            "Both fists": Shape(left="22222", right="22222"),
            "Wave off": Shape(sequence=("point with INDEX", "20220")),
            "Mine": Shape("20000"),
            "Mine twice": Shape(sequence=("Mine", "Mine")),
        }
    )
    assert gestures.composites["Both fists"] == TwoHandGesture("Fist", "Fist")
    assert gestures.composites["Wave off"] == SequenceGesture("Point with index", "Horns")
    assert gestures.names["22222"] == "Fist"
    assert gestures.find("both FISTS") == "Both fists"
    assert gestures.parts_of("Both fists") == (Part("Fist", "22222", "left"), Part("Fist", "22222", "right"))
    assert gestures.parts_of("Wave off") == (Part("Point with index", "20222"), Part("Horns", "20220"))
    assert gestures.parts_of("Horns") == (Part("Horns", "20220"),)
    assert gestures.like("Wave of") == 'did you mean "Wave off"'
    assert "Both fists" not in site.composites
    assert listed(gestures, Commands({3: "Wave off"}))[-2] == {
        "name": "Wave off",
        "sequence": [
            {"gesture": "Point with index", "code": "20222"},
            {"gesture": "Horns", "code": "20220"},
        ],
        "commandId": 3,
    }


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        ({"horns": Shape("20000")}, 'there is a gesture "horns" already'),
        ({"New": Shape("20220")}, 'has the code 20220, which "Horns" already has'),
        ({"New": Shape("20221")}, "a code is five states"),
        ({"New": Shape(left="Horns")}, "names one hand; give a part for left and one for right"),
        ({"New": Shape(sequence=("Horns", "Horn"))}, 'the unknown part "Horn"; did you mean "Horns"'),
        (
            {"A": Shape(left="Horns", right="Horns"), "B": Shape(sequence=("A", "Horns"))},
            '"A" itself is composed; a part is a gesture of one hand',
        ),
        (
            {"A": Shape(left="Horns", right="20220"), "B": Shape(left="20220", right="Horns")},
            'gesture "B" is made like "A"',
        ),
    ],
)
def test_a_gesture_that_cannot_be_is_refused(shapes: dict[str, Shape], words: str) -> None:
    with pytest.raises(WrongGesture) as wrong:
        Gestures(M2O2P_GESTURES).with_shapes(shapes)
    assert words in str(wrong.value)


def test_what_is_asked_goes_before_whatever_else_is_called_or_made_so() -> None:
    gestures = Gestures({"Mine": "20000", "Horns": "20220", "Up": "02222"}).with_shapes(
        {"Twice": Shape(sequence=("Mine", "Horns")), "Both": Shape(left="Up", right="Horns")}
    )
    asked = gestures.with_parts([Part("Hers", "20000"), Part("Up", "00222")])
    assert asked.codes == {"Horns": "20220", "Hers": "20000", "Up": "00222"}
    assert list(asked.composites) == ["Both"]
    assert codes_in_use(asked, Commands({1: "Both", 2: "Mine"}), [Part("Hers", "20000")]) == {
        "00222",
        "20220",
        "20000",
    }
