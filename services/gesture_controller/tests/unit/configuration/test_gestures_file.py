"""Each mistake in the gestures file gets one line that says where, why and what to do."""

from pathlib import Path

import pytest

from handover_datamodels.states import Outcome
from handover_gloves.configuration.gestures_file import (
    WrongConfiguration,
    built_in,
    load,
    parse,
)
from handover_gloves.recognition.gestures import SequenceGesture, TwoHandGesture
from handover_gloves.recognition.thresholds import M2O2P_THRESHOLDS, Threshold

WHOLE = """
gestures:
  Thumbs up: 02222       # no quotes: YAML itself would read a number to the base of eight
  Point with index: 20222
  Ring straight: "22202"
  Both thumbs up: {left: 02222, right: 02222}
  Wave off: {sequence: [Point with index, Ring straight]}
commands:
  3: Thumbs up
  4: point with index
  5: Wave off
persons:
  anna: {3: Ring straight}
answers:
  problem: ring straight
gloves:
  glove-1:
    hand: left
    person: anna
    thresholds:
      thumb: {upper: 990, lower: 790.5}
  glove-2:
"""


def test_a_finger_of_a_glove_may_be_inverted() -> None:
    (glove,) = parse("gloves: {g: {thresholds: {ring: {inverted: true}, thumb: {inverted: false}}}}").gloves
    assert [each.inverted for each in glove.thresholds.fingers] == [False, False, False, True, False]


def test_a_whole_file_is_read() -> None:
    site = parse(WHOLE)
    assert site.gestures.codes["Thumbs up"] == "02222"
    assert site.gestures.composites == {
        "Both thumbs up": TwoHandGesture("Thumbs up", "Thumbs up"),
        "Wave off": SequenceGesture("Point with index", "Ring straight"),
    }
    assert site.commands.gestures == {3: "Thumbs up", 4: "Point with index", 5: "Wave off"}
    assert site.commands_of("anna").gestures == {
        3: "Ring straight",
        4: "Point with index",
        5: "Wave off",
    }
    assert site.commands_of(None) == site.commands_of("ben") == site.commands
    assert site.answers == {Outcome.PROBLEM: "Ring straight"}
    first, second = site.gloves
    assert (first.name, first.hand, first.person) == ("glove-1", "left", "anna")
    assert first.thresholds.fingers[0] == Threshold(990, 790.5)
    assert first.thresholds.fingers[1:] == M2O2P_THRESHOLDS.fingers[1:]
    assert (second.name, second.hand, second.person) == ("glove-2", "right", None)


def test_an_empty_file_is_the_built_in_configuration() -> None:
    assert parse("") == built_in()
    assert load(None) == built_in()
    assert [glove.name for glove in built_in().gloves] == ["glove-1"]


def test_own_gestures_keep_those_default_commands_that_they_have() -> None:
    assert parse("gestures: {Thumbs up: 02222, Fist: 22222}").commands.gestures == {3: "Thumbs up"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("gloves: [", "x.yaml:2: not YAML"),
        ("a\tb: [\n-", "not YAML"),
        ("just words", "x.yaml:1: the file must be names with values"),
        ("- 1", "x.yaml:1: the file must be names with values"),
        ("gesture:\n  Fist: 22222", 'x.yaml:1: unknown section "gesture"; the sections are gestures'),
        (
            "gestures:\n  Point with index: 20220\n  Horns: 20220",
            'x.yaml:3: gesture "Horns" has the code 20220, which "Point with index" already has; '
            "give one of them another code in x.yaml",
        ),
        (
            "gestures:\n  Horns: 20220\n  Horns: 02222",
            'x.yaml:3: "Horns" stands twice in gestures, first in line 2',
        ),
        ("gestures: {Horns: 2022}", 'gesture "Horns" has the code "2022"; a code is five states'),
        ("gestures: {Horns: 20221}", "a code is five states"),
        (
            "gestures: {Horns: 20220, Both: {left: 02222}}",
            'gesture "Both" has left; it is a code such as 02222, or {left: 02222, right: 02222}, or',
        ),
        (
            "gestures:\n  A: 20220\n  B: {sequence: [A]}",
            'x.yaml:3: the sequence of gesture "B" is a list of two',
        ),
        ("gestures:\n  A: 20220\n  B: {sequence: [A, C]}", 'x.yaml:3: gesture "B" has the unknown part "C"'),
        ("[" * 5000, "nested too deeply"),
        ("gestures: {Horns: [2]}", 'the code of gesture "Horns" must be a word or a number'),
        ("gestures: {Horns: }", 'the code of gesture "Horns" must be a word or a number'),
        ("commands: {3: Thumb up}", 'command 3 has the unknown gesture "Thumb up"; did you mean "Thumbs up"'),
        ("commands: {three: Thumbs up}", 'command "three" is not a whole number'),
        ("commands: {3: Horns, 4: Horns}", '"Horns" stands for the commands 3 and 4; give one of them'),
        ("commands:\n  3: Horns\n  3: Thumbs up", 'x.yaml:3: "3" stands twice in commands'),
        ("persons: {anna: {3: Wave}}", 'command 3 has the unknown gesture "Wave"'),
        ("persons: {anna: {3: Horns}}", '"Horns" stands for the commands 3 and 8 for "anna"'),
        ("persons: {anna: 3}", 'person "anna" must be names with values'),
        ("gloves:\n  glove-1:\n  glove-1:", 'x.yaml:3: "glove-1" stands twice in gloves, first in line 2'),
        ("gloves: {glove 1: {}}", 'glove "glove 1": a name is 1 to 64 letters'),
        ("gloves: {g: {hand: third}}", 'glove "g": hand is left or right, not "third"'),
        ("gloves: {g: {colour: red}}", 'glove "g" has an unknown field "colour"'),
        ("gloves: {g: {person: anna}, h: {person: anna}}", 'person "anna" wears both g and h'),
        (
            "gloves:\n  g:\n    thresholds:\n      pinky: {upper: 2, lower: 1}",
            'x.yaml:4: glove "g": unknown finger "pinky"; the fingers are thumb, index, middle, ring, little',
        ),
        (
            "gloves: {g: {thresholds: {ring: {upper: 500, lower: 600}}}}",
            'glove "g": ring: the lower threshold 600 is above the upper one 500',
        ),
        ("gloves: {g: {thresholds: {ring: {upper: high}}}}", 'ring upper must be a number, not "high"'),
        ("gloves: {g: {thresholds: {ring: {upper: .nan}}}}", "ring upper must be a number"),
        ("gloves: {g: {thresholds: {ring: {upper: nan}}}}", "ring: thresholds are finite numbers"),
        ("gloves: {g: {thresholds: {ring: {top: 5}}}}", 'ring: unknown bound "top"'),
        ("gloves: {g: {thresholds: {ring: {inverted: 5}}}}", 'ring inverted must be true or false, not "5"'),
        ("gloves: {g: {thresholds: 5}}", 'the thresholds of glove "g" must be names with values'),
    ],
)
def test_a_mistake_is_one_clear_line(text: str, words: str) -> None:
    with pytest.raises(WrongConfiguration) as wrong:
        parse(text, "x.yaml")
    message = str(wrong.value)
    assert words in message
    assert message.startswith("x.yaml")
    assert "\n" not in message


def test_a_file_that_is_not_there_is_named_with_its_setting(tmp_path: Path) -> None:
    with pytest.raises(WrongConfiguration, match=r"nowhere\.yaml cannot be read .* HANDOVER_GESTURES_FILE"):
        load(tmp_path / "nowhere.yaml")


def test_a_file_is_named_in_its_errors(tmp_path: Path) -> None:
    path = tmp_path / "cell-3.yaml"
    path.write_text("commands: {3: Wave}")
    with pytest.raises(WrongConfiguration, match=r"^cell-3\.yaml:1: "):
        load(path)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(WrongConfiguration, match="cannot be read"):
        load(path)


@pytest.mark.parametrize(
    ("answers", "wrong"),
    [
        ("{ok: Horns}", 'unknown answer "ok"'),
        ("{notGood: Hornes}", 'the answer notGood has the unknown gesture "Hornes"; did you mean "Horns"'),
        ("{notGood: Horns, problem: horns}", '"Horns" stands for both notGood and problem'),
        ("{problem: Wave}", '"Wave", which takes two hands or two steps'),
        ("{problem: Fist}", '"Fist", which is how a hand rests or carries'),
    ],
)
def test_a_wrong_answer_gesture_is_refused_with_the_way_out(answers: str, wrong: str) -> None:
    gestures = "gestures: {Horns: 20220, Fist: 22222, Wave: {sequence: [Horns, Fist]}}"
    with pytest.raises(WrongConfiguration) as refused:
        parse(f"{gestures}\nanswers: {answers}\ncommands: {{1: Horns}}\n")
    assert "gestures.yaml:2: " in str(refused.value)
    assert wrong in str(refused.value)


def test_an_answer_gesture_that_is_also_a_commands_is_said_when_the_file_is_read() -> None:
    site = parse("answers: {notGood: Horns}\npersons: {anna: {3: Horns, 8: Thumbs up}}\n")
    assert [line.split(":")[0] for line in site.restricted_answers()] == [
        '"Horns" is the gesture of the answer notGood and of the command 8',
        '"Horns" is the gesture of the answer notGood and of the command 3 of anna',
    ]
    assert built_in().restricted_answers() == []
