"""Recognizers are found by name, a stranger's too; one that fails says so and thresholds take over."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from handover_gloves.gloves.glove import Glove
from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.gestures import M2O2P_GESTURES, Gestures
from handover_gloves.recognition.levels import calibrate
from handover_gloves.recognition.pipeline import PipelineState, RecognitionConfig, process_frame
from handover_gloves.recognition.registry import (
    PERSONAL,
    THRESHOLDS,
    UnknownRecognizer,
    factory_of,
    recognizers,
)
from handover_gloves.recognition.thresholds import Threshold, Thresholds
from tests.kit.paths import REPOSITORY

SAME = Thresholds((Threshold(600, 400),) * 5)
GESTURES = Gestures(M2O2P_GESTURES)
CALIBRATION = calibrate([[300.0] * 5] * 20, [[700.0] * 5] * 20)
THUMB_UP = [700.0, 300, 300, 300, 300]


def a_package(folder: Path, name: str, where: str) -> None:
    """Put what an installed package leaves behind into `folder`: its entry point."""
    information = folder / f"{name}-1.0.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(f"[handover.recognizers]\n{name} = {where}\n")


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place where packages are installed."""
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_ours_are_there() -> None:
    assert recognizers()[:2] == [THRESHOLDS, PERSONAL]


def test_the_example_is_found_by_its_entry_point_and_works(
    installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(REPOSITORY / "examples" / "nearest_recognizer"))
    a_package(installed, "nearest", "nearest_recognizer:Nearest")
    assert "nearest" in recognizers()
    config = RecognitionConfig(SAME, GESTURES, calibration=CALIBRATION, recognizer_name="nearest")
    assert config.missing is None
    state = process_frame(PipelineState(), Frame(0.0, THUMB_UP), config)
    assert state.gesture == "Thumbs up"
    assert state.recognition is not None
    assert config.recognizer.odds(state.recognition)["Thumbs up"] == 1
    assert "Thumbs up" in config.recognizer.why(state.recognition)
    assert process_frame(state, Frame(0.02, [500.0] * 5), config).gesture is None


def test_an_unknown_name_is_answered_with_those_there_are() -> None:
    with pytest.raises(UnknownRecognizer, match='no recognizer "threshold"; there are thresholds, personal'):
        factory_of("threshold")


def test_a_package_that_cannot_be_imported_is_named(installed: Path) -> None:
    a_package(installed, "broken", "no_such_module:Thing")
    with pytest.raises(UnknownRecognizer, match=r'"broken" \(no_such_module:Thing\) cannot be loaded'):
        factory_of("broken")


@pytest.mark.parametrize(
    ("name", "words"), [("personal", "calibrate the glove first"), ("gone", 'no recognizer "gone"')]
)
def test_where_the_chosen_one_cannot_work_thresholds_do_and_it_is_said(name: str, words: str) -> None:
    config = RecognitionConfig(SAME, GESTURES, recognizer_name=name)
    assert words in (config.missing or "")
    assert process_frame(PipelineState(), Frame(0.0, THUMB_UP), config).gesture == "Thumbs up"


@pytest.mark.nightly
def test_a_controller_that_uses_thresholds_does_not_load_numpy() -> None:
    code = "import sys, handover_gloves.app; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY).returncode == 0


FAILS = """
class Fails:
    def __init__(self, given):
        pass

    def see(self, before, frame):
        raise ZeroDivisionError("in the middle of the work")
"""


def test_a_recognizer_that_fails_at_work_takes_no_glove_away(
    installed: Path, glove: Glove, hand: Any
) -> None:
    (installed / "fails.py").write_text(FAILS)
    a_package(installed, "fails", "fails:Fails")
    glove.configure(replace(glove.reader.config, recognizer_name="fails"))
    hand.show("Thumbs up", 0.2)
    assert glove.reader.state.gesture == "Thumbs up"
    assert glove.reader.config.missing == "it failed with ZeroDivisionError: in the middle of the work"
    assert glove.connection.traffic.frames == 10


def test_who_learns_other_gestures_goes_on_with_the_same_recognizer(glove: Glove, hand: Any) -> None:
    levels = calibrate([[300.0] * 5] * 20, [[700.0] * 5] * 20)
    glove.configure(replace(glove.reader.config, calibration=levels, recognizer_name=PERSONAL))
    hand.show("Horns", 0.3)
    more = Gestures({**glove.reader.config.gestures.codes, "Four fingers": "20000"})
    glove.equip(more, glove.responder.commands)
    assert glove.reader.config.missing is None
    hand.make("20000", 0.5)
    assert glove.reader.state.gesture == "Four fingers"
