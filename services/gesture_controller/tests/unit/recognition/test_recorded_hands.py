"""The numbers of `make bench-gestures` come from the stated seconds alone (docs/measurements.md)."""

import random
from pathlib import Path

import pytest

from benchmarks.gloves import recorded_hands
from benchmarks.gloves.recorded_hands import (
    CODES,
    FIST,
    OPEN,
    SIX,
    Recording,
    WrongRecording,
    at_work,
    calibrated,
    config_for,
    confirmed,
    half_way,
    look,
    measure,
    population_without,
    read,
    report,
)
from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.population import USUAL, learn
from handover_gloves.recognition.registry import PERSONAL, THRESHOLDS

FIST_LEVELS, OPEN_LEVELS = (300.0, 500, 500, 500, 450), (400.0, 700, 700, 690, 680)


def made_up(seed: int = 1, poses: str = "0123456789") -> Recording:
    """A person whose fingers do as the labels say, and half of it in poses 7 and 9."""
    chance = random.Random(seed)
    made = {}
    for pose in poses:
        shares = [{"0": 1.0, "2": 0.1}[state] for state in CODES[pose]] if pose in CODES else [0.55] * 5
        levels = [
            low + share * (high - low)
            for low, share, high in zip(FIST_LEVELS, shares, OPEN_LEVELS, strict=True)
        ]
        made[pose] = [[level + chance.gauss(0, 2) for level in levels] for _ in range(250)]
    return Recording("made up", made, fingerprint=f"made up {seed}")


def beyond_the_stated_seconds_spoilt(person: Recording, *, samples: bool) -> Recording:
    """The same person, but that all frames that may not be used are nonsense."""
    chance = random.Random(9)
    spoilt = {}
    for pose, frames in person.poses.items():
        kept = person.hz if pose in {FIST, OPEN} or (samples and pose in CODES) else 0
        nonsense = [[chance.uniform(-5000, 5000) for _ in range(5)] for _ in frames[kept:]]
        spoilt[pose] = [*frames[:kept], *nonsense]
    return Recording(person.name, spoilt, person.hz, person.fingerprint)


@pytest.fixture(scope="module")
def people(recordings: Path) -> list[Recording]:
    """The three who were recorded."""
    return [read(path) for path in sorted(recordings.glob("*.csv"))]


def probes() -> list[list[float]]:
    chance = random.Random(3)
    return [[chance.uniform(250, 750) for _ in range(5)] for _ in range(200)]


@pytest.mark.parametrize("recognizer", ["thresholds", PERSONAL])
@pytest.mark.parametrize("samples", [False, True])
def test_no_frame_of_a_person_but_the_stated_seconds_tunes_anything_for_them(
    recognizer: str, samples: bool
) -> None:
    others = [made_up(2), made_up(3)]
    honest = made_up(1)
    spoilt = beyond_the_stated_seconds_spoilt(honest, samples=samples)
    answers = []
    for person in (honest, spoilt):
        config = config_for(person, [person, *others], recognizer, samples=samples)
        reader, seen, results = config.recognizer, None, []
        for number, bend in enumerate(probes()):
            seen = reader.see(seen, Frame(number / 50, bend))
            results.append((seen.gesture, seen.states, seen.certainty))
        answers.append((config.thresholds, config.calibration, results))
    assert answers[0] == answers[1]


def test_whose_recordings_the_population_was_learnt_from_is_measured_without_them(
    people: list[Recording],
) -> None:
    for person in people:
        without = population_without(person, people)
        assert without != USUAL
        spoilt = [
            beyond_the_stated_seconds_spoilt(one, samples=False) if one is person else one for one in people
        ]
        assert population_without(person, spoilt) == without
    stranger = made_up(4)
    assert population_without(stranger, [*people, stranger]) == USUAL


def test_the_population_is_what_the_recordings_teach(people: list[Recording]) -> None:
    hands = []
    for person in people:
        levels = calibrated(person).levels
        hands.append(
            {
                code: [
                    [(bend - level.fist) / level.span for bend, level in zip(frame, levels, strict=True)]
                    for frame in person.poses[pose]
                ]
                for pose, code in CODES.items()
            }
        )
    assert learn(hands) == USUAL


def test_half_way_thresholds_give_what_was_measured_before(people: list[Recording]) -> None:
    """83.9 %, 99.9 % and 97.3 %, over poses 0 to 6 and 8: so the rest is measured alike."""
    measured = [half_way(person, whole_poses=True).accuracy(tuple(CODES)) for person in people]
    assert [round(100 * share, 1) for share in measured] == [83.9, 99.9, 97.3]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "least"), [("a", 0.82), ("b", 0.997), ("c", 0.985)])
def test_thresholds_are_better_than_half_way_and_confirm_nothing_that_was_not_meant(
    people: list[Recording], name: str, least: float
) -> None:
    person = next(one for one in people if one.name.endswith(name))
    score = measure(person, config_for(person, people, THRESHOLDS))
    assert score.accuracy(SIX) >= least
    assert score.accuracy(SIX) > half_way(person, whole_poses=False).accuracy(SIX) + 0.009
    assert {what: names for what, names in score.confirmed.items() if names} == {}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "least"), [("a", 0.86), ("b", 0.999), ("c", 0.99)])
def test_a_fist_and_an_open_hand_suffice_for_gestures_in_use(
    people: list[Recording], name: str, least: float
) -> None:
    person = next(one for one in people if one.name.endswith(name))
    config = config_for(person, people, PERSONAL, in_use=frozenset(CODES.values()))
    right = frames = 0
    for pose, code in CODES.items():
        used = person.hz if pose in {FIST, OPEN} else 0
        seen = look(person.poses[pose], config, person.hz)[used:]
        right += sum(state.states == code and state.gesture is not None for state in seen)
        frames += len(seen)
    assert right / frames >= least
    for pose in ("7", "9"):
        assert not {*confirmed(look(person.poses[pose], config, person.hz))} - {"Fist"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a", "b", "c"])
def test_a_second_of_each_gesture_leaves_hardly_an_error(people: list[Recording], name: str) -> None:
    person = next(one for one in people if one.name.endswith(name))
    config = config_for(person, people, PERSONAL, samples=True)
    for pose in SIX:
        seen = look(person.poses[pose], config, person.hz)[person.hz :]
        right = sum(state.states == CODES[pose] and state.gesture is not None for state in seen)
        assert right / len(seen) >= 0.995


@pytest.mark.parametrize("recognizer", [THRESHOLDS, PERSONAL])
def test_a_minute_of_assembly_confirms_nothing(recognizer: str) -> None:
    person = made_up(1)
    config = config_for(person, [person], recognizer)
    for seed in range(2):
        assert not {*confirmed(look(at_work(person, seed), config, person.hz))} - {"Fist", "Open hand"}


def test_any_folder_is_measured_and_what_cannot_be_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorded_hands, "ASSEMBLIES", 1)
    monkeypatch.setattr(recorded_hands, "ASSEMBLY_S", 5.0)
    header = "pose,thumb,index,middle,ring,little\n"
    person = made_up(5)
    rows = [
        f"{pose},{','.join(f'{value:.1f}' for value in frame)}\n"
        for pose in ("0", "5", "2")
        for frame in person.poses[pose]
    ]
    (tmp_path / "d.csv").write_text(header + "".join(rows))
    (tmp_path / "e.csv").write_text("pose,thumb\n0,1\n")
    (tmp_path / "f.csv").write_text(header + "0,1,2,3,4,x\n")
    (tmp_path / "g.csv").write_text(header + "0,1,2,3,4,5\n")
    lines = list(report(tmp_path))
    assert "left out: e.csv: no column index, little, middle, ring" in lines[0]
    assert "f.csv:2: not five numbers" in lines[1]
    assert "more than a second of pose 0 (fist) is needed" in lines[2]
    assert any(line.strip().startswith("personal: d") and "100.00%" in line for line in lines)
    with pytest.raises(WrongRecording):
        read(tmp_path / "e.csv")


def test_the_score_counts_frames_and_windows() -> None:
    person = made_up(1, "025")
    score = measure(person, config_for(person, [person], PERSONAL))
    assert score.accuracy(("2",)) == 1.0
    assert score.windows["2"] == 2
    assert score.reaching() == 1.0
