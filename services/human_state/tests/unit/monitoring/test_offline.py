"""`handover body analyse` reads a recording as the service would, and says what it leaves out."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from handover_body.command_line.body import app
from handover_body.drivers.recording.tracks import read
from services.human_state.tests.unit.hearts import Heart, heart


def written(path: Path, given: Heart, keep: np.ndarray | None = None) -> Path:
    opener = gzip.open if path.suffix == ".gz" else open
    rows = np.arange(len(given.ecg)) if keep is None else keep
    with opener(path, "wt") as file:
        file.write("time,ecg [mV],note\n")
        file.writelines(f"{row / given.rate_hz:.6f},{given.ecg[row]:.6f},1\n" for row in rows)
    return path


def analysed(path: Path, *options: str) -> dict[str, list[dict[str, object]]]:
    result = CliRunner().invoke(app, ["analyse", str(path), "--json", *options])
    assert result.exit_code == 0, result.output
    answer: dict[str, list[dict[str, object]]] = json.loads(result.stdout)
    return answer


@pytest.mark.parametrize("name", ["fast.csv", "fast.csv.gz"])
def test_a_recording_is_analysed_and_what_is_left_out_is_named(name: str, tmp_path: Path) -> None:
    answer = analysed(written(tmp_path / name, heart(188, 25)))
    assert set(answer) == {"features", "channels", "left_out"}
    assert [one["name"] for one in answer["channels"]] == ["ecg"]
    assert [one["name"] for one in answer["left_out"]] == ["note"]
    assert "kind" in str(answer["left_out"][0]["reason"])
    rates = [one for one in answer["features"] if one["name"] == "heartRate"]
    assert set(rates[0]) == {"name", "value", "at_s", "quality", "status", "channel"}
    assert all(abs(float(str(one["value"])) - 188) < 6 for one in rates)
    assert 0 < float(str(rates[0]["at_s"])) < 12


def test_an_ecg_with_missing_rows_keeps_its_rate_and_is_valid_again(tmp_path: Path) -> None:
    given = heart(150, 40)
    keep = np.concatenate((np.arange(0, 18 * 360), np.arange(21 * 360, len(given.ecg))))
    path = written(tmp_path / "gap.csv", given, keep)
    assert read(path, {}).tracks[0].info.rate_hz == pytest.approx(360, rel=1e-3)
    rates = [one for one in analysed(path)["features"] if one["name"] == "heartRate"]
    assert any(one["status"] != "valid" for one in rates if 18 < float(str(one["at_s"])) < 22)
    assert any(one["status"] == "valid" for one in rates if 21 < float(str(one["at_s"])) < 36)


def test_a_channel_is_named_with_its_kind(tmp_path: Path) -> None:
    path = written(tmp_path / "named.csv", heart(70, 20))
    text = path.read_text().replace("ecg [mV]", "CH1 [mV]")
    path.write_text(text)
    assert [one["kind"] for one in analysed(path, "--channel", "CH1=ecg")["channels"]] == ["ecg"]
    refused = CliRunner().invoke(app, ["analyse", str(path), "--channel", "CH1=heart"])
    assert refused.exit_code != 0
    assert "NAME=KIND" in str(refused.exception)


@pytest.mark.parametrize(
    ("column", "rate_hz", "reason"),
    [
        ("ecg [mV]", 11, "R peaks need an ECG of 50 to 2,000 Hz; this one has 11 Hz"),
        ("eda", 4, "EDA needs microsiemens (D80)"),
        ("hr", 1, "a heartRate comes in BPM, not in C62"),
        ("hr [mV]", 1, "a heartRate comes in BPM, not in D82"),
        ("rr", 1, "inter-beat intervals come in C26 (ms) or SEC, not in C62"),
        ("eeg [uV]", 250, "nothing is computed from the kind eeg"),
        ("eda [Ohm]", 4, 'the unit "Ohm" of "eda" is not known'),
    ],
)
def test_a_signal_that_yields_nothing_is_named_with_the_reason(
    column: str, rate_hz: float, reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "some.csv"
    rows = [f"{at / rate_hz:.6f},1,{70 + at % 2}\n" for at in range(100)]
    path.write_text(f"time [s],{column},pleth\n" + "".join(rows))
    name = column.split(maxsplit=1)[0]
    answer = analysed(path)
    assert name not in [one["name"] for one in answer["channels"]]
    (said,) = (one["reason"] for one in answer["left_out"] if one["name"] == name)
    assert reason in str(said)
    printed = CliRunner().invoke(app, ["analyse", str(path)]).output
    assert f"{name} is left out: {reason}" in printed.replace("\n", "")


def test_a_channel_is_named_with_its_kind_and_unit(tmp_path: Path) -> None:
    path = tmp_path / "raw.csv"
    path.write_text("time [s],A1\n" + "".join(f"{at / 4},2\n" for at in range(400)))
    answer = analysed(path, "--channel", "A1=eda[uS]")
    assert [(one["kind"], one["unit"]) for one in answer["channels"]] == [("eda", "D80")]
