"""The classifier of activities: what it says of simulated people, and which model files it refuses."""

from pathlib import Path

import numpy as np
import pytest

from handover_body.model.features import Feature
from handover_body.model.signals import SensorFault, SensorReport, SignalInfo, SignalKind
from handover_body.processing.adl.classifier import AdlClassifier, UnusableModel, load_model
from handover_body.processing.adl.training import main, simulated_activity
from handover_body.processing.synthesis import packets_of

IMU = SignalInfo(SignalKind.ACCELERATION, "MSK", 25.0, ("x", "y", "z"))
MAT = SignalInfo(SignalKind.PRESSURE_MAP, "C62", 25.0, tuple(f"r{r}c{c}" for r in range(3) for c in range(4)))
BEGIN_S = 1_700_000_000.0


def activity(classifier: AdlClassifier, recording: np.ndarray, begin_s: float = BEGIN_S) -> list[Feature]:
    imu = packets_of(IMU, recording[:, :3], "imu", begin_s, 25)
    mat = packets_of(MAT, recording[:, 3:], "mat", begin_s, 25)
    return [f for pair in zip(imu, mat, strict=True) for packet in pair for f in classifier.feed(packet)]


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["Rest", "Self Propulsion", "Washing Hands", "Pressure Relief"])
def test_an_activity_of_a_person_it_has_not_seen_is_named(name: str) -> None:
    found = activity(AdlClassifier(load_model(), "adl"), simulated_activity(name, person=1000, seconds=20))
    assert found[-1].value == name
    assert not found[-1].is_calibrated
    assert len(found) == pytest.approx(14, abs=2)


def test_a_fault_ends_the_window() -> None:
    classifier = AdlClassifier(load_model(), "adl")
    activity(classifier, simulated_activity("Rest", 1000, 10))
    classifier.report(SensorReport("imu", BEGIN_S + 10, fault=SensorFault.GAP))
    assert activity(classifier, simulated_activity("Rest", 1000, 5), BEGIN_S + 10) == []


def test_one_sensor_alone_gives_nothing() -> None:
    classifier = AdlClassifier(load_model(), "adl")
    imu = packets_of(IMU, simulated_activity("Rest", 1, 20)[:, :3], "imu", BEGIN_S, 25)
    assert [f for packet in imu for f in classifier.feed(packet)] == []


def test_a_model_that_holds_other_types_is_refused(tmp_path: Path) -> None:
    import skops.io
    from sklearn.preprocessing import FunctionTransformer

    path = tmp_path / "hostile.skops"
    skops.io.dump(FunctionTransformer(func=activity), path)
    with pytest.raises(UnusableModel, match="not trusted"):
        load_model(path)


def test_pickle_garbage_and_other_classes_are_refused(tmp_path: Path) -> None:
    import skops.io
    from sklearn.linear_model import LogisticRegression

    with pytest.raises(UnusableModel, match="pickle is never read"):
        load_model(tmp_path / "model.pkl")
    garbage = tmp_path / "garbage.skops"
    garbage.write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(UnusableModel, match="cannot be read"):
        load_model(garbage)
    other = tmp_path / "other.skops"
    skops.io.dump(LogisticRegression().fit([[0.0], [1.0]], ["cat", "dog"]), other)
    with pytest.raises(UnusableModel, match="the classes are Rest"):
        load_model(other)


def test_training_on_recordings_names_a_wrong_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "anna__flying.csv").write_text("1,2\n")
    assert main(["--out", str(tmp_path / "m.skops"), "--data", str(tmp_path)]) == 2
    assert "anna__flying.csv must be named <person>__<activity>.csv" in capsys.readouterr().err


def test_a_model_is_trained_on_recordings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for person in range(5):
        for name, stem in (("Rest", "rest"), ("Arm Raises", "arm-raises")):
            rows = simulated_activity(name, person, 12)
            np.savetxt(tmp_path / f"p{person}__{stem}.csv", rows, delimiter=",", fmt="%.4f")
    out = tmp_path / "model.skops"
    assert main(["--out", str(out), "--data", str(tmp_path)]) == 0
    assert "recorded people" in capsys.readouterr().out
    assert set(load_model(out).classes_) == {"Rest", "Arm Raises"}
