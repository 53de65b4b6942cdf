"""Features, waveforms and sessions come back from FHIR R5, and others' Observations are judged."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("fhir.resources", reason="the extra [human-state] is not installed")

from fhir.resources.bundle import Bundle
from fhir.resources.observation import Observation

from handover_body.exchange import fhir, fhir_codes
from handover_body.formats.errors import ExchangeError
from handover_body.formats.json_messages import Marker
from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import Samples, SensorReport, SignalInfo, SignalKind
from services.human_state.tests.unit.exchange.random_signals import features, same_values

RATE = Feature(FeatureName.HEART_RATE, "h10", 92.5, 1_770_000_000.25, 0.9, method="ecg 1.0")
ECG = Samples(
    "h10",
    SignalInfo(SignalKind.ECG, "D82", 130.0, ("I", "II"), method="patch"),
    1_770_000_000.5,
    np.array([[1.5, -2.0], [float("nan"), 3.25], [0.0, 1e-3]]),
    quality=0.75,
)


def codes(observation: dict[str, Any]) -> set[tuple[str, str]]:
    return {(one["system"], one["code"]) for one in observation["code"]["coding"]}


@settings(max_examples=60)
@given(features())
def test_a_feature_comes_back_from_a_valid_observation(one: Feature) -> None:
    written = fhir.observation_of(one, "p-1")
    assert Observation.model_validate(written).status == (
        "final" if one.status is Status.VALID else "preliminary"
    )
    back = fhir.feature_of(written)
    assert back.at_s == pytest.approx(one.at_s, abs=1e-5)
    assert back.window_s == pytest.approx(one.window_s, abs=1e-5)
    assert replace(back, at_s=one.at_s, window_s=one.window_s, period_s=one.period_s) == one


@pytest.mark.parametrize(
    ("name", "method", "expected"),
    [
        (FeatureName.HEART_RATE, "ecg", {(fhir_codes.LOINC, "8867-4"), (fhir_codes.MDC, "147842")}),
        (FeatureName.HEART_RATE, "ppg", {(fhir_codes.LOINC, "8867-4"), (fhir_codes.MDC, "149530")}),
        (FeatureName.HEART_RATE, "radar", {(fhir_codes.LOINC, "8867-4")}),
        (FeatureName.HEART_RATE, "ecg, ppg", {(fhir_codes.LOINC, "8867-4")}),
        (FeatureName.BREATHING_RATE, "radar", {(fhir_codes.LOINC, "9279-1"), (fhir_codes.MDC, "151562")}),
        (
            FeatureName.SPO2,
            "ppg",
            {(fhir_codes.LOINC, "2708-6"), (fhir_codes.LOINC, "59408-5"), (fhir_codes.MDC, "150456")},
        ),
        (FeatureName.HRV_SDNN, "ecg", {(fhir_codes.LOINC, "80404-7")}),
        (FeatureName.HRV_RMSSD, "ecg", set()),
        (FeatureName.SKIN_TEMPERATURE, "", {(fhir_codes.MDC, "150388")}),
    ],
)
def test_codes_say_what_was_measured(name: FeatureName, method: str, expected: set[tuple[str, str]]) -> None:
    found = codes(fhir.observation_of(replace(RATE, name=name, method=method), "p-1"))
    assert found == expected | {(fhir_codes.LOCAL, name.value)}


def test_the_subject_is_a_pseudonym_and_nothing_else() -> None:
    assert fhir.observation_of(RATE, "p-1")["subject"] == {
        "type": "Patient",
        "identifier": {"system": fhir_codes.PSEUDONYM, "value": "p-1"},
    }


def test_the_observation_of_another_system_raises_no_limit() -> None:
    theirs = {
        "resourceType": "Observation",
        "status": "final",
        "code": {"coding": [{"system": fhir_codes.MDC, "code": "149530"}]},
        "effectiveDateTime": "2026-03-02T09:12:04+01:00",
        "valueQuantity": {"value": 48, "code": "{beat}/min", "system": fhir_codes.UCUM},
    }
    found = fhir.feature_of(theirs)
    assert (found.name, found.value, found.status, found.quality) == (
        FeatureName.HEART_RATE,
        48.0,
        Status.IMPLAUSIBLE,
        0.0,
    )
    assert found.at_s == 1_772_439_124.0


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        ({"code": {"coding": [{"system": fhir_codes.LOINC, "code": "1-1"}]}}, "http://loinc.org 1-1"),
        ({"valueQuantity": {"value": 1.5, "code": "Hz"}}, "must be in /min"),
        ({"valueQuantity": None}, "no valueQuantity"),
        ({"effectiveDateTime": None}, "no effective time"),
        ({"status": None}, "FHIR R5"),
        ({"resourceType": "Patient"}, "must be an Observation"),
        ({"soul": 1}, "FHIR R5"),
    ],
)
def test_a_faulty_observation_is_refused_with_the_rule(change: dict[str, Any], reported: str) -> None:
    written = {**fhir.observation_of(RATE, "p-1"), **change}
    with pytest.raises(ExchangeError, match=reported):
        fhir.feature_of({key: value for key, value in written.items() if value is not None})


def test_a_number_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ExchangeError, match="leave it out"):
        fhir.observation_of(replace(RATE, value=float("nan")), "p-1")


def test_a_waveform_comes_back_with_gaps_channels_and_quality() -> None:
    written = fhir.waveform_of(ECG, "p-1")
    assert written["valueSampledData"]["data"] == "1.5 -2.0 E 3.25 0.0 0.001"
    back = fhir.samples_of(written)
    assert same_values(back, ECG)
    assert back.info.rate_hz == pytest.approx(130.0)
    assert (back.info.channels, back.info.unit, back.info.method, back.quality) == (
        ("I", "II"),
        "D82",
        "patch",
        0.75,
    )


@given(st.lists(st.floats(-1e4, 1e4) | st.just(float("nan")), min_size=1, max_size=20))
@settings(max_examples=30)
def test_any_waveform_comes_back(values: list[float]) -> None:
    one = replace(ECG, info=SignalInfo(SignalKind.ECG, "D82", 250.0), values=np.array(values).reshape(-1, 1))
    assert same_values(fhir.samples_of(fhir.waveform_of(one, "p-1")), one, times_within_s=1e-5)


@pytest.mark.parametrize(
    "info", [SignalInfo(SignalKind.ECG, "D82", None), SignalInfo(SignalKind.ECG, "XYZ", 130.0)]
)
def test_a_signal_that_fhir_cannot_hold_is_refused(info: SignalInfo) -> None:
    with pytest.raises(ExchangeError, match="ecg"):
        fhir.waveform_of(Samples("h10", info, 0.0, np.zeros((1, 1)), np.zeros(1)), "p-1")


def test_a_session_is_a_bundle_and_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    items = [fhir.observation_of(RATE, "p-1"), fhir.waveform_of(ECG, "p-1"), fhir.observation_of(RATE, "p-1")]
    bundle = fhir.bundle_of(items, "urn:ngsi-ld:PhysiologicalSession:demo:s", 1_770_000_100.0)
    assert len(Bundle.model_validate(bundle).entry) == 2
    (rate,), (wave,) = fhir.read_bundle(bundle)
    assert rate.value == 92.5
    assert same_values(wave, ECG)
    monkeypatch.setattr(fhir, "MAX_ENTRIES", 1)
    with pytest.raises(ExchangeError, match="at most 1 "):
        fhir.bundle_of(items, "urn:x:y", 0.0)


def test_a_recording_becomes_a_bundle_and_says_what_is_left_out() -> None:
    irregular = replace(ECG, info=replace(ECG.info, rate_hz=None), times_s=np.array([1.0, 2.0, 3.0]))
    items = [
        RATE,
        ECG,
        Marker(1.0, "task"),
        SensorReport("h10", 1.0),
        replace(RATE, value=float("inf")),
        irregular,
    ]
    bundle, left_out = fhir.session_bundle(items, "p-1", "urn:ngsi-ld:PhysiologicalSession:demo:s", 0.0)
    assert (len(bundle["entry"]), left_out) == (2, 2)
    assert bundle["identifier"]["value"] == "urn:ngsi-ld:PhysiologicalSession:demo:s"


def test_packets_become_observations_of_up_to_a_minute_and_a_gap_begins_another() -> None:
    info = SignalInfo(SignalKind.ECG, "D82", 130.0, method="chest")
    values = np.random.default_rng(1).normal(size=(130 * 90, 1))
    packets = [
        Samples("h10", info, 100.0 + at / 130 + (5.0 if at >= 130 * 80 else 0.0), values[at : at + 65])
        for at in range(0, len(values), 65)
    ]
    bundle, left_out = fhir.session_bundle(packets, "P-1", "urn:ngsi-ld:PhysiologicalSession:x:1", 1.0)
    _, waves = fhir.read_bundle(bundle)
    assert left_out == 0
    assert [round(len(wave.values) / 130, 1) for wave in waves] == [60.0, 20.0, 10.0]
    assert [wave.start_s for wave in waves] == pytest.approx([100.0, 160.0, 185.0])
    np.testing.assert_array_equal(np.vstack([wave.values for wave in waves]), values)


def test_a_blink_is_refused_by_its_name() -> None:
    info = SignalInfo(SignalKind.BLINK, "", None, ("duration_s",))
    blink = Samples("glasses", info, 1.0, np.array([[0.2]]), np.array([1.0]))
    with pytest.raises(ExchangeError, match="blink of glasses has no rate"):
        fhir.waveform_of(blink, "p-1")
