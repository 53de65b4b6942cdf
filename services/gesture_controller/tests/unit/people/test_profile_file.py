"""A profile goes out and comes in again unchanged; each mistake in one is a line that says where and why."""

from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_gloves.calibration.glove_store import Fit
from handover_gloves.configuration.gestures_file import built_in
from handover_gloves.people.person import OwnGesture, Person, Sample
from handover_gloves.people.profile_file import Profile, WrongProfile, read, written
from handover_gloves.recognition.gestures import M2O2P_GESTURES, Shape
from handover_gloves.recognition.thresholds import FINGERS, M2O2P_THRESHOLDS

SITE = built_in()
FREE = sorted({f"{n:05b}".replace("1", "2") for n in range(32)} - set(M2O2P_GESTURES.values()))
NUMBERS = st.floats(-1e6, 1e6).map(lambda number: number + 0.0)
FIVE = st.tuples(*[NUMBERS] * 5)
JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**50), 2**50)
    | NUMBERS
    | st.text("aÄ :#'\"-[]{}\n0.", max_size=6),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text("ab1 :", max_size=3), inner, max_size=3)
    ),
    max_leaves=8,
)


def gesture(number: int, code: str, sample: Sample | None) -> tuple[str, OwnGesture]:
    return f"My {number}", OwnGesture(Shape(code), sample)


SAMPLES = st.none() | st.builds(Sample, st.just("glove-1"), FIVE, FIVE)
OWN = st.lists(st.sampled_from(FREE), unique=True, max_size=5).flatmap(
    lambda codes: st.tuples(*[SAMPLES for _ in codes]).map(
        lambda samples: dict(
            gesture(number, code, sample)
            for number, (code, sample) in enumerate(zip(codes, samples, strict=True))
        )
    )
)
BOUNDS = st.tuples(NUMBERS, NUMBERS, st.booleans()).map(
    lambda drawn: {"upper": max(drawn[:2]), "lower": min(drawn[:2]), "inverted": drawn[2]}
)
THRESHOLDS = st.none() | st.fixed_dictionaries(dict.fromkeys(FINGERS, BOUNDS)).map(
    M2O2P_THRESHOLDS.with_changes
)
FITS = st.dictionaries(
    st.sampled_from(["glove-1", "007", "1e3"]),
    st.builds(
        Fit,
        THRESHOLDS,
        st.none(),
        st.none() | st.just("personal"),
        st.dictionaries(st.text("ab1", min_size=1, max_size=3), JSON, max_size=3),
    ),
)
TITLES = st.none() | st.text("Aä 0:#'-", min_size=1, max_size=9).filter(lambda text: bool(text.strip()))


@given(TITLES, OWN, FITS, st.booleans())
def test_what_goes_out_comes_in_again_unchanged(
    title: str | None, own: Mapping[str, OwnGesture], fits: Mapping[str, Fit], composed: bool
) -> None:
    gestures = dict(own)
    if composed:
        gestures["Both"] = OwnGesture(Shape(left="02222", right="Horns"))
        gestures["SequenceProgress"] = OwnGesture(Shape(sequence=("22200", "Horns")))
    commands: dict[int, Any] = {100 + number: name for number, name in enumerate(gestures)}
    person = Person("anna", title, {**commands, 8: None}, gestures)
    text = written(Profile(person, fits))
    assert read(text, SITE) == Profile(person, fits)
    assert written(read(text, SITE)) == text


def test_a_profile_can_be_read_by_people() -> None:
    person = Person("anna", "Anna", {3: "Mine", 8: None}, {"Mine": OwnGesture(Shape("20000"))})
    assert written(Profile(person, {"glove-1": Fit(M2O2P_THRESHOLDS)})).splitlines()[:8] == [
        "person: anna",
        "title: Anna",
        "commands: {3: Mine, 8: null}",
        "gestures: {Mine: '20000'}",
        "gloves:",
        "  glove-1:",
        "    thresholds:",
        "      thumb: {upper: 1000, lower: 800}",
    ]
    assert read("person: anna\ngestures: {Mine: 20000}", SITE).person.gestures["Mine"].shape.code == "20000"


def test_the_name_in_the_address_counts() -> None:
    assert read("person: anna", SITE, person="ben").person.name == "ben"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "p.yaml:1: the profile is empty"),
        ("person: [", "p.yaml:2: not YAML"),
        ("commands: {3: Horns}", "p.yaml:1: nobody is named"),
        ("person: An na", 'p.yaml:1: person "An na": a name is 1 to 64 letters'),
        ("person: anna\nglove: {}", 'p.yaml:2: unknown section "glove"; the sections are person, title'),
        ("person: anna\ncommands: {x: Horns}", 'p.yaml:2: command "x" is not a whole number'),
        (
            "person: anna\ncommands:\n  8: null\n  3: Wave",
            'p.yaml:4: command 3 has the unknown gesture "Wave"',
        ),
        (
            "person: anna\ncommands:\n  1: null\n  3: Horns",
            'p.yaml:4: "Horns" stands for the commands 3 and 8 for anna',
        ),
        (
            "person: anna\ngestures:\n  Mine: 20000\n  Yours: 20000",
            'p.yaml:4: gesture "Yours" has the code 20000, which "Mine" already has',
        ),
        ("person: anna\ngestures:\n  Horns: 20000", 'p.yaml:3: there is a gesture "Horns" already'),
        (
            "person: anna\ngestures:\n  A: {sequence: [B, Horns]}",
            'p.yaml:3: gesture "A" has the unknown part "B"',
        ),
        (
            "person: anna\ngestures:\n  A: {code: 20000, sample: {glove: g}}",
            "a sample has glove, levels and noise",
        ),
        (
            "person: anna\ngestures:\n  A: {code: 20000, sample: {glove: g, levels: [1], noise: [1]}}",
            "p.yaml:3: the levels of a sample are five numbers",
        ),
        ("person: anna\ngloves:\n  g:\n    colour: red", 'p.yaml:4: glove "g" has an unknown field "colour"'),
        (
            "person: anna\ngloves:\n  g:\n    thresholds: {ring: {upper: 1, lower: 2}}",
            "the lower threshold 2 is above",
        ),
        ("person: anna\ngloves:\n  g:\n    learnt: 5", "learnt must be names with values"),
        (
            "person: anna\ngloves:\n  g:\n    learnt: {a: !!python/none x}",
            "p.yaml:4: what was learnt cannot be read",
        ),
    ],
)
def test_a_mistake_is_one_clear_line(text: str, words: str) -> None:
    with pytest.raises(WrongProfile) as wrong:
        read(text, SITE, "p.yaml")
    message = str(wrong.value)
    assert words in message
    assert message.startswith("p.yaml:")


LEARNT = "person: anna\ngloves:\n  glove-1:\n    learnt:\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            LEARNT + "      x: &x [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
            "      y: &y [*x, *x, *x, *x, *x, *x, *x, *x, *x, *x]\n"
            "      z: &z [*y, *y, *y, *y, *y, *y, *y, *y, *y, *y]\n"
            "      w: &w [*z, *z, *z, *z, *z, *z, *z, *z, *z, *z]\n"
            "      v: [*w, *w, *w, *w, *w, *w, *w, *w, *w, *w]\n",
            r"profile.yaml:9: too many values; 20000 are allowed, aliases counted in full",
        ),
        (LEARNT + "      x: &x [1, *x]\n", r"\*x stands within itself"),
        (LEARNT + "      x: " + "[" * 400_000, "nested too deeply; 50 levels are allowed"),
        (LEARNT + "      x: [" + "1, " * 300_000 + "1]\n", "too many values"),
        (LEARNT + "      x: !!set {a, b}\n", "what was learnt cannot be read"),
        (
            "person: anna\ngestures:\n"
            + "".join(f"  G{nth}: {{left: Horns, right: Horns}}\n" for nth in range(101)),
            "a person has 100 gestures of their own at most",
        ),
        (
            LEARNT + "      samples: {" + ", ".join(f"'{nth}': 1" for nth in range(244)) + "}\n",
            "243 samples are allowed",
        ),
    ],
    ids=["laughs", "itself", "deep", "long", "no JSON", "gestures", "samples"],
)
def test_a_profile_that_would_grow_without_bound_is_refused(text: str, words: str) -> None:
    with pytest.raises(WrongProfile, match=words):
        read(text, SITE)


def test_an_alias_within_bounds_stands_for_its_value() -> None:
    text = LEARNT + "      x: &x [1, 2]\n      y: *x\n"
    assert read(text, SITE).fits["glove-1"].learnt == {"x": [1, 2], "y": [1, 2]}
