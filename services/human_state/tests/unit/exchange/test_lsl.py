"""Streams of the Lab Streaming Layer between an outlet and an inlet on this machine."""

import time
import uuid
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pylsl", reason="the extra [human-state] is not installed")

import pylsl

from handover_body.exchange.lsl import LslInlet, LslOutlets
from handover_body.formats.errors import ExchangeError
from handover_body.formats.lsl import signal_info
from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import Samples, SignalInfo, SignalKind
from tests.kit.waiting import scaled

ECG = SignalInfo(SignalKind.ECG, "D82", 130.0, ("I", "II"), method="patch")


@pytest.fixture
def source() -> str:
    return f"h10-{uuid.uuid4().hex[:8]}"  # every test machine of the network sees the streams


@pytest.fixture
def outlets() -> Iterator[LslOutlets]:
    made = LslOutlets("p-1")
    yield made
    made.close()


def found(name: str) -> Any:
    streams = pylsl.resolve_byprop("name", name, timeout=scaled(20))
    assert streams, f"the stream {name} was not found"
    return streams[0]


def until(condition: Callable[[], Any]) -> Any:
    end_s = time.monotonic() + scaled(20)
    while time.monotonic() < end_s:
        if result := condition():
            return result
        time.sleep(0.01)
    raise AssertionError("the condition was never true")


def test_samples_arrive_with_their_times_unit_channels_and_subject(outlets: LslOutlets, source: str) -> None:
    def ecg(values: np.ndarray[Any, Any]) -> Samples:
        return Samples(source, ECG, time.time(), values)

    outlets.push(ecg(np.zeros((1, 2))))  # announces the stream
    inlet = LslInlet(found(f"{source} ecg"), scaled(20))
    until(lambda: outlets.has_consumers(f"{source} ecg"))
    sent = ecg(np.array([[1.5, -2.0], [float("nan"), 3.25]]))
    outlets.push(sent)
    got: list[Samples] = []

    def received() -> bool:
        if (part := inlet.pull()) is not None:
            got.append(part)
        return bool(got) and bool(np.any(got[-1].values == 3.25))

    until(received)
    values = np.concatenate([part.values for part in got])
    times_s = np.concatenate([part.sample_times_s() for part in got])
    assert values[-2:].tolist()[0] == [1.5, -2.0]
    assert np.isnan(values[-1][0])
    # Both clocks of LSL are the same here, and its estimate of the offset is off by the time of a round trip.
    assert times_s[-2:] == pytest.approx(sent.sample_times_s(), abs=scaled(2))
    assert (inlet.signal, inlet.subject) == (ECG, "p-1")
    inlet.close()


def test_features_and_texts_are_streams(outlets: LslOutlets, source: str) -> None:
    rate = Feature(FeatureName.HEART_RATE, source, 92.5, time.time(), 0.9)
    signal = SignalInfo(SignalKind.HEART_RATE, "BPM", 1.0)
    outlets.push(Samples(source, signal, time.time(), np.array([[92.0]])))  # a signal of the same name
    outlets.push(rate)
    inlet = pylsl.StreamInlet(found(f"{source} heartRate feature"))
    inlet.open_stream(scaled(20))
    until(lambda: outlets.has_consumers(f"{source} heartRate feature"))
    outlets.push(rate)
    assert until(lambda: inlet.pull_sample(timeout=0.1)[0]) == [92.5, 0.9, 1.0]
    described = inlet.info(scaled(20))
    assert described.desc().child("channels").child("channel").child_value("unit") == "BPM"
    outlets.push(Feature(FeatureName.ACTIVITY, source, "Rest", time.time(), 0.9))
    with pytest.raises(ExchangeError, match="Markers"):
        signal_info(found(f"{source} activity feature"))


def test_a_stream_of_others_is_read_by_its_type_and_unit() -> None:
    info = pylsl.StreamInfo("theirs", "EEG", 2, 250.0, pylsl.cf_float32, "x")
    channels = info.desc().append_child("channels")
    for label in ("C3", "C4"):
        channel = channels.append_child("channel")
        channel.append_child_value("label", label)
        channel.append_child_value("unit", "microvolts")
    signal, subject = signal_info(info)
    assert (signal.kind, signal.unit, signal.rate_hz, signal.channels) == (
        SignalKind.EEG,
        "D82",
        250.0,
        ("C3", "C4"),
    )
    assert subject == ""
    bare, _ = signal_info(pylsl.StreamInfo("theirs", "ECG", 2, 0.0, pylsl.cf_float32, "x"))
    assert (bare.channels, bare.rate_hz) == (("0", "1"), None)


@pytest.mark.parametrize(
    ("kind", "data", "reported"),
    [("Soul", pylsl.cf_float32, "Soul; known are"), ("ECG", pylsl.cf_string, "no signal")],
)
def test_a_stream_that_is_no_signal_is_refused(kind: str, data: int, reported: str) -> None:
    with pytest.raises(ExchangeError, match=reported):
        signal_info(pylsl.StreamInfo("theirs", kind, 1, 0.0, data, "x"))
