"""What is written to MCAP and XDF is read from them: by us, by their own readers, and by our driver."""

import io
import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("mcap", reason="the extra [human-state] is not installed")

import pyxdf

from handover_body.drivers.recording import tracks
from handover_body.exchange import mcap, xdf
from handover_body.formats.errors import ExchangeError
from handover_body.formats.json_messages import (
    SCHEMAS,
    Marker,
    Recorded,
    from_json,
    schema_name,
    time_of,
    to_json,
)
from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import (
    LinkState,
    Samples,
    SensorFault,
    SensorReport,
    SignalInfo,
    SignalKind,
)
from services.human_state.tests.unit.exchange.random_signals import (
    features,
    names,
    same_values,
    samples,
    times,
    words,
)

reports = st.builds(
    SensorReport,
    names,
    times,
    st.none() | st.sampled_from(LinkState),
    st.none() | st.floats(0, 1),
    st.none() | st.booleans(),
    st.none() | st.sampled_from(SensorFault),
    words,
    st.dictionaries(words, st.floats(-1e6, 1e6), max_size=2),
)
markers = st.builds(Marker, times, names, words)
items = samples() | features() | reports | markers

ECG = SignalInfo(SignalKind.ECG, "D82", 130.0, ("chest",))


def an_ecg(number: int = 0) -> Samples:
    values = np.sin(np.arange(73.0) + 73 * number).reshape(-1, 1)
    return Samples("h10", ECG, 1_770_000_000.0 + number * 73 / 130.0, values)


def is_same(one: Recorded, other: Recorded) -> bool:
    if isinstance(one, Samples):
        return isinstance(other, Samples) and one.info == other.info and same_values(one, other)
    return one == other


@given(items)
def test_an_item_comes_back_from_json_that_satisfies_its_schema(item: Recorded) -> None:
    message = json.loads(json.dumps(to_json(item, "p-1"), allow_nan=False))
    jsonschema.validate(message, SCHEMAS[schema_name(item)])
    assert message["subject"] == "p-1"
    assert is_same(from_json(schema_name(item), message), item)


@given(st.sampled_from(sorted(SCHEMAS)), st.dictionaries(words, st.none() | words | st.floats()) | st.none())
def test_any_json_is_read_or_refused_with_the_schema(name: str, message: Any) -> None:
    with pytest.raises(ExchangeError, match=name):
        from_json(name, message)


@settings(max_examples=40)
@given(st.lists(items, max_size=5))
def test_a_recording_in_mcap_comes_back_by_time(tmp_path_factory: Any, given_items: list[Recorded]) -> None:
    path = tmp_path_factory.mktemp("mcap") / "session.mcap"
    with path.open("wb") as file, mcap.McapWriter(file, "p-1", {"purpose": "study"}) as writer:
        for item in given_items:
            writer.write(item)
    found = list(mcap.read(path))
    assert len(found) == len(given_items)
    ordered = sorted(given_items, key=lambda item: round(time_of(item) * 1e9))
    assert [round(time_of(item), 6) for item in found] == [round(time_of(item), 6) for item in ordered]
    assert all(any(is_same(item, other) for other in given_items) for item in found)
    assert mcap.metadata_of(path) == {"subject": "p-1", "purpose": "study"}


def test_the_reader_of_mcap_finds_topics_schemas_and_times(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    path = tmp_path / "session.mcap"
    with path.open("wb") as file, mcap.McapWriter(file) as writer:
        writer.write(an_ecg())
        writer.write(Marker(1_770_000_001.0, "task", "started"))
    with path.open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages())
    assert [channel.topic for _, channel, _ in found] == ["/signal/h10/ecg", "/marker"]
    assert all(schema is not None and schema.encoding == "jsonschema" for schema, _, _ in found)
    assert found[1][2].log_time == 1_770_000_001_000_000_000


@pytest.mark.parametrize("cut", [0, 10, 200, -30])
def test_a_damaged_recording_is_named(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "session.mcap"
    with path.open("wb") as file, mcap.McapWriter(file) as writer:
        writer.write(an_ecg())
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(ExchangeError, match=r"session\.mcap"):
        list(mcap.read(path))


@pytest.mark.parametrize("suffix", ["mcap", "xdf"])
def test_the_driver_of_recordings_replays_what_was_recorded(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"session.{suffix}"
    with path.open("wb") as file:
        writer = mcap.McapWriter(file) if suffix == "mcap" else xdf.XdfWriter(file)
        with writer:
            for number in range(4):
                writer.write(an_ecg(number))
            writer.write(Marker(1_770_000_001.0, "task"))
    (track,) = tracks.read(path, {}).tracks
    assert (track.info.kind, track.info.unit) == (SignalKind.ECG, "D82")
    assert track.info.rate_hz == pytest.approx(130.0)
    expected = np.concatenate([an_ecg(number).values for number in range(4)])
    assert track.values == pytest.approx(expected)


@settings(max_examples=40)
@given(st.lists(items, max_size=5))
def test_pyxdf_reads_every_sample_and_time(given_items: list[Recorded]) -> None:
    stream = io.BytesIO()
    with xdf.XdfWriter(stream, "p-1") as writer:
        for item in given_items:
            writer.write(item)
    stream.seek(0)
    if not writer.count:
        return
    found, header = pyxdf.load_xdf(stream, synchronize_clocks=True, dejitter_timestamps=False)
    assert header["info"]["version"] == ["1.0"]
    signals = [item for item in given_items if isinstance(item, Samples)]
    series = [one for one in found if one["info"]["channel_format"] == ["double64"]]
    written = np.sort(np.concatenate([np.empty(0), *(item.values.ravel() for item in signals)]))
    read = [one["time_series"].ravel() for one in series if one["info"]["type"] != ["Feature"]]
    assert np.sort(np.concatenate([np.empty(0), *read])) == pytest.approx(written, nan_ok=True)
    stamps = [one["time_stamps"] for one in series if one["info"]["type"] != ["Feature"]]
    times_s = [item.sample_times_s() for item in signals]
    assert np.sort(np.concatenate([np.empty(0), *stamps])) == pytest.approx(
        np.sort(np.concatenate([np.empty(0), *times_s])), abs=1e-6
    )


def test_pyxdf_reads_markers_features_units_and_subject() -> None:
    stream = io.BytesIO()
    with xdf.XdfWriter(stream, "p-1") as writer:
        writer.write(an_ecg())
        writer.write(Feature(FeatureName.HEART_RATE, "h10", 92.5, 1_770_000_000.5, 0.9))
        writer.write(Marker(1_770_000_000.25, "task", "started"))
        writer.write(SensorReport("h10", 1_770_000_000.3, fault=SensorFault.GAP, text="2 s"))
    stream.seek(0)
    found, _ = pyxdf.load_xdf(stream)
    by_name = {one["info"]["name"][0]: one for one in found}
    assert by_name["markers"]["time_series"] == [["task: started"]]
    assert by_name["h10 reports"]["time_series"] == [["gap: 2 s"]]
    assert by_name["h10 heartRate"]["time_series"].tolist() == [[92.5, 0.9, 1.0]]
    described = by_name["h10 ecg"]["info"]["desc"][0]
    assert described["channels"][0]["channel"][0]["unit"] == ["D82"]
    assert described["subject"][0]["id"] == ["p-1"]


def test_a_long_recording_has_boundaries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xdf, "BOUNDARY_EVERY_BYTES", 2000)
    stream = io.BytesIO()
    with xdf.XdfWriter(stream) as writer:
        for number in range(20):
            writer.write(an_ecg(number))
    whole = stream.getvalue()
    assert whole.count(bytes.fromhex("43A546DCCBF5410FB30ED5467383CBE4")) >= 8
    (found,), _ = pyxdf.load_xdf(io.BytesIO(whole))
    assert len(found["time_series"]) == 20 * 73
