"""Recordings of five formats are replayed with their times and units; damaged files are refused by name."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from handover_body.drivers.recording.channels import (
    Meaning,
    RecordingError,
    kind_of,
    plausible_rates_hz,
)
from handover_body.drivers.recording.driver import RecordingDriver, RecordingSettings
from handover_body.drivers.recording.tracks import read
from handover_body.drivers.runner import SensorRunner
from handover_body.exchange.mcap import McapWriter
from handover_body.model.signals import Samples, SensorFault, SensorReport, SignalInfo, SignalKind
from tests.kit.paths import REPOSITORY

PHYSIOLOGY = REPOSITORY.parent / "shared" / "data" / "physiology"
needs_records = pytest.mark.skipif(not PHYSIOLOGY.exists(), reason="the records of PhysioNet are not here")
ECG_MV = np.sin(np.arange(500) / 10) + np.random.default_rng(0).normal(0, 0.01, 500)


def in_wfdb(folder: Path) -> Path:
    import wfdb

    wfdb.wrsamp(
        "made",
        250,
        ["mV", "NU"],
        ["II", "PLETH"],
        np.column_stack([ECG_MV, ECG_MV]),
        fmt=["16", "16"],
        write_dir=str(folder),
    )
    return folder / "made.hea"


def in_edf(folder: Path) -> Path:
    import pyedflib

    path = folder / "made.edf"
    with pyedflib.EdfWriter(str(path), 1) as writer:
        writer.setSignalHeaders(
            [{"label": "ECG II", "dimension": "mV", "sample_frequency": 250,
              "physical_max": 5.0, "physical_min": -5.0,
              "digital_max": 32767, "digital_min": -32768, "transducer": "", "prefilter": ""}]
        )  # fmt: skip
        writer.writeSamples([ECG_MV])
    return path


def in_csv(folder: Path) -> Path:
    path = folder / "made.csv"
    lines = [f"{at / 250:.6f},{value:.9f},\n" for at, value in enumerate(ECG_MV)]
    path.write_text("time,ecg [mV],note\n" + "".join(lines))
    return path


def in_mcap(folder: Path) -> Path:
    """Write a recording as the service does."""
    path = folder / "made.mcap"
    info = SignalInfo(SignalKind.ECG, "D82", 250.0, ("I",))
    with path.open("wb") as file, McapWriter(file) as writer:
        for first in range(0, 500, 50):
            values = 1000 * ECG_MV[first : first + 50, None]
            writer.write(Samples("belt", info, 1_700_000_000 + first / 250, values))
    return path


def in_xdf(folder: Path) -> Path:
    """Write one stream as XDF 1.0: magic, file header, stream header, samples, stream footer."""
    import struct

    def chunk(tag: int, content: bytes) -> bytes:
        return b"\x04" + struct.pack("<I", len(content) + 2) + struct.pack("<H", tag) + content

    header = (
        b"<?xml version='1.0'?><info><name>ECG</name><type>ECG</type><channel_count>1</channel_count>"
        b"<nominal_srate>250</nominal_srate><channel_format>double64</channel_format><source_id>x</source_id>"
        b"<desc><channels><channel><label>I</label><unit>mV</unit></channel></channels></desc></info>"
    )
    body = struct.pack("<I", 1) + b"\x04" + struct.pack("<I", len(ECG_MV))
    for at, value in enumerate(ECG_MV):
        body += b"\x08" + struct.pack("<d", 50 + at / 250) + struct.pack("<d", value)
    footer = (
        b"<?xml version='1.0'?><info><first_timestamp>50</first_timestamp>"
        b"<last_timestamp>51.996</last_timestamp>"
        b"<sample_count>500</sample_count><clock_offsets></clock_offsets></info>"
    )
    stream = struct.pack("<I", 1)
    path = folder / "made.xdf"
    path.write_bytes(
        b"XDF:"
        + chunk(1, b"<?xml version='1.0'?><info><version>1.0</version></info>")
        + chunk(2, stream + header)
        + chunk(3, body)
        + chunk(6, stream + footer)
    )
    return path


WRITERS = {".hea": in_wfdb, ".edf": in_edf, ".csv": in_csv, ".mcap": in_mcap, ".xdf": in_xdf}


async def replay(path: Path, **given: Any) -> tuple[list[Samples], list[SensorReport]]:
    driver = RecordingDriver("file", RecordingSettings(path=path, **{"pace": 0, **given}))
    items: list[Samples | SensorReport] = []
    await SensorRunner(driver, items.append).run()
    return [one for one in items if isinstance(one, Samples)], [
        one for one in items if isinstance(one, SensorReport)
    ]


@pytest.mark.parametrize("suffix", WRITERS)
async def test_each_format_is_replayed_in_microvolts_without_faults(suffix: str, tmp_path: Path) -> None:
    samples, reports = await replay(WRITERS[suffix](tmp_path))
    ecg = [one for one in samples if one.info.kind is SignalKind.ECG]
    values = np.concatenate([one.values[:, 0] for one in ecg])
    assert len(values) == 500
    assert ecg[0].info.unit == "D82"
    assert ecg[0].info.rate_hz == pytest.approx(250, rel=1e-4)
    assert values == pytest.approx(1000 * ECG_MV, abs=1)
    times = np.concatenate([one.sample_times_s() for one in ecg])
    assert np.allclose(np.diff(times), 1 / 250, atol=1e-6)
    assert not [report for report in reports if report.fault]


@pytest.mark.parametrize("suffix", WRITERS)
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(cut=st.integers(0, 2000), noise=st.binary(max_size=20))
def test_a_damaged_file_is_refused_or_read_and_nothing_else(
    suffix: str, cut: int, noise: bytes, tmp_path: Path
) -> None:
    path = WRITERS[suffix](tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole[: cut % len(whole)] + noise)
    try:
        recording = read(path, {})
    except RecordingError:
        pass
    else:
        assert all(len(track.values) for track in recording.tracks)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.txt", "x", "must end with one of"),
        ("a.csv", "ecg,time\n1,2\n", "first column"),
        ("a.csv", "time,ecg [furlong]\n0,1\n1,2\n", "not known"),
        ("a.csv", "time,ecg\n0,1\n1\n", "line 3"),
        ("a.csv", "time,ecg\n0,1\n1,many\n", "no number"),
        ("a.csv", "time,ecg\n0,1\n5,2\n1,3\n", "backwards"),
        ("a.csv", "time,other\n0,1\n1,2\n", "`channels`"),
        ("a.csv", "time,ecg\n", "fewer than two"),
    ],
)
def test_a_file_that_is_wrong_is_refused_with_the_way_out(
    name: str, text: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(RecordingError, match=message):
        read(tmp_path / name, {})


def test_a_file_that_is_absent_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"there is no recording .*gone\.csv"):
        read(tmp_path / "gone.csv", {})


async def test_a_loop_continues_without_a_fault(tmp_path: Path) -> None:
    items: list[Samples | SensorReport] = []

    class Enough(Exception):
        pass

    def sink(item: Samples | SensorReport) -> None:
        items.append(item)
        if isinstance(item, Samples) and item.end_s - first_s() > 5:
            raise Enough

    def first_s() -> float:
        return next(one for one in items if isinstance(one, Samples)).start_s

    driver = RecordingDriver("file", RecordingSettings(path=in_csv(tmp_path), pace=0, loop=True))
    with pytest.raises(Enough):
        await driver.run(sink)
    ends = [one for one in items if isinstance(one, Samples)]
    steps = [after.start_s - before.end_s for before, after in itertools.pairwise(ends)]
    assert max(abs(step - 1 / 250) for step in steps) < 1e-4


async def test_times_that_were_recorded_are_kept(tmp_path: Path) -> None:
    samples, _ = await replay(in_mcap(tmp_path), times="recorded")
    assert samples[0].start_s == pytest.approx(1_700_000_000)


async def test_a_gap_in_a_table_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "gap.csv"
    rows = [f"{at / 250 + (3 if at > 200 else 0)},{np.sin(at)}\n" for at in range(400)]
    path.write_text("time,ecg [mV]\n" + "".join(rows))
    samples, _ = await replay(path)
    times = np.concatenate([one.sample_times_s() for one in samples])
    assert np.diff(times).max() == pytest.approx(3 + 1 / 250)


@needs_records
@pytest.mark.parametrize(
    ("name", "kinds"),
    [
        ("100", ["ecg", "ecg"]),
        ("a103l", ["ecg", "ecg", "ppg"]),
        ("v102s", ["ecg", "ecg", "ppg", "respiration"]),
    ],
)
async def test_records_of_physionet_are_replayed(name: str, kinds: list[str]) -> None:
    driver = RecordingDriver("file", RecordingSettings(path=PHYSIOLOGY / f"{name}.hea", pace=0, packet_s=10))
    assert [info.kind.value for info in driver.signals] == kinds
    items: list[Samples | SensorReport] = []
    await SensorRunner(driver, items.append).run()
    jumps = {one.fault for one in items if isinstance(one, SensorReport)} & {
        SensorFault.GAP,
        SensorFault.CLOCK_JUMP,
        SensorFault.RATE,
        SensorFault.UNIT,
    }
    assert not jumps


@pytest.mark.parametrize(
    "name",
    ["MLII", "MCL1", "vx", "vy", "VZ", "aVR", "I", "lead III", "V5", "CM5", "mod.V1", "ML5", "ECG 2", "D3"],
)
def test_leads_of_an_ecg_are_understood(name: str) -> None:
    assert kind_of(name) is SignalKind.ECG


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("heartRate", SignalKind.HEART_RATE),
        ("hr", SignalKind.HEART_RATE),
        ("Resp thorax", SignalKind.RESPIRATION),
        ("EEG Fp1", SignalKind.EEG),
        ("ACC_X", SignalKind.ACCELERATION),
        ("whatever", None),
        ("hrv", None),
        ("resp rate", None),
        ("temperature_ambient", None),
        ("template", None),
        ("accuracy", None),
        ("ecg_quality", None),
        ("", None),
    ],
)
def test_a_name_means_a_kind_only_where_that_is_clear(name: str, kind: SignalKind | None) -> None:
    assert kind_of(name) is kind


@given(rates=st.lists(st.sampled_from((1, 2, 8, 25, 100, 200)), min_size=1, max_size=4))
@settings(max_examples=10, deadline=None)
def test_each_signal_of_a_wfdb_record_has_its_own_rate(
    tmp_path_factory: pytest.TempPathFactory, rates: list[int]
) -> None:
    """Frames of 1 s with several samples of some signals, as records of polysomnography have them."""
    import wfdb

    folder, seconds = tmp_path_factory.mktemp("rates"), 8
    given_mv = [np.sin(np.arange(seconds * rate) / rate * 2 * np.pi / 3) for rate in rates]
    wfdb.wrsamp(
        "made", 1, ["mV"] * len(rates), [f"ECG{at}" for at in range(len(rates))],
        e_p_signal=given_mv, samps_per_frame=rates, fmt=["16"] * len(rates), write_dir=str(folder),
    )  # fmt: skip
    tracks = read(folder / "made.hea", {}).tracks
    assert [track.info.rate_hz for track in tracks] == rates
    for track, wave in zip(tracks, given_mv, strict=True):
        assert track.values[:, 0] == pytest.approx(1000 * wave, abs=1)


def test_one_channel_that_is_not_known_leaves_the_others(tmp_path: Path) -> None:
    """An unknown unit or name leaves its channel out, with the reason; nothing vanishes."""
    path = tmp_path / "mixed.csv"
    rows = "".join(f"{at / 100},1,2,3,4\n" for at in range(300))
    path.write_text("time [s],ecg [mV],eda [Ohm],resp [pm],note\n" + rows)
    recording = read(path, {})
    assert [track.name for track in recording.tracks] == ["ecg"]
    reasons = {one.name: one.reason for one in recording.left_out}
    assert reasons.keys() == {"eda", "resp", "note"}
    assert 'the unit "Ohm" of "eda" is not known' in reasons["eda"]
    assert "kind is not clear" in reasons["note"]
    driver = RecordingDriver("file", RecordingSettings(path=path))
    assert driver.left_out == reasons
    with pytest.raises(RecordingError, match='the unit "Ohm"'):
        read(path, {"eda": Meaning(SignalKind.EDA)})
    assert read(path, {"eda": Meaning(SignalKind.EDA, "uS")}).tracks[0].info.unit == "D80"


def test_nothing_that_is_known_is_refused_with_the_reason_for_each(tmp_path: Path) -> None:
    path = tmp_path / "none.csv"
    path.write_text("time,eda [Ohm],note\n0,1,1\n1,1,1\n")
    with pytest.raises(RecordingError, match=r'"Ohm" of "eda".*note: its kind is not clear'):
        read(path, {})


@pytest.mark.parametrize(
    ("unit", "code", "factor"), [("mS", "D80", 1000), ("uS", "D80", 1), ("us", "D80", 1), ("ms", "C26", 1)]
)
def test_siemens_are_no_seconds(unit: str, code: str, factor: float, tmp_path: Path) -> None:
    path = tmp_path / "eda.csv"
    path.write_text(f"time,eda [{unit}]\n" + "".join(f"{at / 4},2\n" for at in range(40)))
    (track,) = read(path, {}).tracks
    assert (track.info.unit, track.values[0, 0]) == (code, 2 * factor)


@given(kind=st.sampled_from(sorted(SignalKind)), share=st.floats(0, 1))
def test_times_are_plausible_in_one_of_s_and_ms_at_most(kind: SignalKind, share: float) -> None:
    least_hz, most_hz = plausible_rates_hz(kind)
    rate_hz = least_hz * (most_hz / least_hz) ** share
    assert least_hz <= rate_hz * (1 + 1e-9)
    assert not least_hz <= rate_hz / 1000 <= most_hz
    assert not least_hz <= rate_hz * 1000 <= most_hz


HEADERS = {
    "time [s]": 1.0, "time": 1.0, "t": 1.0, "seconds": 1.0, "timestamp_s": 1.0, "Time (s)": 1.0,
    "time [ms]": 1e3, "time_ms": 1e3, "Time (ms)": 1e3, "milliseconds": 1e3, "timestamp [us]": 1e6,
    "time [min]": 1 / 60,
}  # fmt: skip


@given(
    header=st.sampled_from(sorted(HEADERS)),
    column=st.sampled_from(
        (("ecg [mV]", 50, 2000), ("eda [uS]", 4, 128), ("hr [bpm]", 0.02, 5), ("resp", 2, 500))
    ),
    share=st.floats(0, 1),
    began_s=st.sampled_from((0.0, 12.5, 1.7e9)),
)
@settings(max_examples=60, deadline=None)
def test_a_rate_is_never_wrong_by_a_factor(
    tmp_path_factory: pytest.TempPathFactory,
    header: str,
    column: tuple[str, float, float],
    share: float,
    began_s: float,
) -> None:
    name, least_hz, most_hz = column
    rate_hz = least_hz * (most_hz / least_hz) ** share
    path = tmp_path_factory.mktemp("times") / "a.csv"

    def write(header: str, factor: float) -> None:
        times = (f"{(began_s + at / rate_hz) * factor:.9f},1\n" for at in range(20))
        path.write_text(f"{header},{name}\n" + "".join(times))

    write(header, HEADERS[header])
    (track,) = read(path, {}).tracks
    assert track.info.rate_hz == pytest.approx(rate_hz, rel=1e-2)
    for factor in (1e-3, 1e3, 1e6, 1e9):
        write("time", factor)
        with pytest.raises(RecordingError, match="Hz"):
            read(path, {})


@pytest.mark.parametrize("header", ["temp", "temperature", "trial", "time [h]", "time (frames)", "ecg", ""])
def test_a_first_column_that_is_no_time_is_refused(header: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"{header},ecg [mV]\n0,1\n0.01,2\n0.02,1\n")
    with pytest.raises(RecordingError, match=r"a\.csv"):
        read(path, {})
