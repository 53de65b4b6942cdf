"""The codes of features and units in HL7 FHIR: LOINC, MDC, UCUM, and a system of our own.

Codes were compared with public implementation guides (docs/reference/body-signal-formats.md says which), not
with the licensed tables: LOINC 8867-4 (heart rate), 9279-1 (respiratory rate),
59408-5 and 2708-6 (oxygen saturation, the second is required by the vital-signs profile), 80404-7 (standard
deviation of the intervals between beats, so SDNN only), 55423-8 (steps); ISO/IEEE 11073-10101 (MDC) 147842
heart rate from the ECG, 149530 pulse rate, 151562 respiratory rate, 150456 SpO2, 150388 skin temperature.
RMSSD and whatever else has no code there have one of our own system, which every Observation carries, so that
reading is exact.
"""

from collections.abc import Mapping
from typing import Any, Final

from handover_body.formats.errors import ExchangeError
from handover_body.model.features import Feature, FeatureName

LOINC: Final = "http://loinc.org"
MDC: Final = "urn:iso:std:iso:11073:10101"
LOCAL: Final = "https://w3id.org/handover/codes/human-state"
UCUM: Final = "http://unitsofmeasure.org"
PSEUDONYM: Final = "https://w3id.org/handover/pseudonym"
SOURCE: Final = "https://w3id.org/handover/sensor"
CATEGORY: Final = "http://terminology.hl7.org/CodeSystem/observation-category"

_LOINC_OF: Final[Mapping[FeatureName, tuple[tuple[str, str], ...]]] = {
    FeatureName.HEART_RATE: (("8867-4", "Heart rate"),),
    FeatureName.BREATHING_RATE: (("9279-1", "Respiratory rate"),),
    FeatureName.SPO2: (
        ("2708-6", "Oxygen saturation in Arterial blood"),
        ("59408-5", "Oxygen saturation in Arterial blood by Pulse oximetry"),
    ),
    FeatureName.HRV_SDNN: (("80404-7", "R-R interval.standard deviation (Heart rate variability)"),),
    FeatureName.STEPS: (("55423-8", "Number of steps in unspecified time Pedometer"),),
}
_MDC_OF: Final[Mapping[FeatureName, tuple[str, str]]] = {
    FeatureName.BREATHING_RATE: ("151562", "MDC_RESP_RATE"),
    FeatureName.SPO2: ("150456", "MDC_PULS_OXIM_SAT_O2"),
    FeatureName.SKIN_TEMPERATURE: ("150388", "MDC_TEMP_SKIN"),
}
_MDC_HEART_RATE: Final = ("147842", "MDC_ECG_HEART_RATE")
_MDC_PULSE_RATE: Final = ("149530", "MDC_PULS_OXIM_PULS_RATE")
_ACTIVITIES: Final = frozenset(
    {
        FeatureName.STEPS,
        FeatureName.CADENCE,
        FeatureName.ACTIVITY,
        FeatureName.MOVEMENT,
        FeatureName.BODY_MOVEMENT,
    }
)
UCUM_OF: Final[Mapping[FeatureName, str]] = {
    FeatureName.HEART_RATE: "/min",
    FeatureName.BREATHING_RATE: "/min",
    FeatureName.CADENCE: "/min",
    FeatureName.HRV_RMSSD: "ms",
    FeatureName.HRV_SDNN: "ms",
    FeatureName.SPO2: "%",
    FeatureName.BODY_MOVEMENT: "%",
    FeatureName.EDA_TONIC: "uS",
    FeatureName.EDA_PHASIC: "uS",
    FeatureName.EMG_ENVELOPE: "uV",
    FeatureName.SKIN_TEMPERATURE: "Cel",
    FeatureName.BLINK_RATE: "/min",
    FeatureName.BLINK_DURATION: "ms",
    FeatureName.FIXATION_DURATION: "ms",
    FeatureName.SACCADE_RATE: "Hz",
    FeatureName.SACCADE_AMPLITUDE: "deg",
    FeatureName.PUPIL_DIAMETER: "mm",
    FeatureName.CENTRE_OF_PRESSURE_X: "mm",
    FeatureName.CENTRE_OF_PRESSURE_Y: "mm",
}
"""Others are fractions, counts and numbers of events: `1`."""
_VITAL: Final = frozenset(
    {FeatureName.HEART_RATE, FeatureName.BREATHING_RATE, FeatureName.SPO2, FeatureName.SKIN_TEMPERATURE}
)
UCUM_OF_SIGNAL: Final = {
    "D82": "uV",
    "D80": "uS",
    "CEL": "Cel",
    "BPM": "/min",
    "C94": "/min",
    "C26": "ms",
    "SEC": "s",
    "P1": "%",
    "MSK": "m/s2",
    "K40": "[g]",
    "MTR": "m",
    "MMT": "mm",
    "DD": "deg",
    "HTZ": "Hz",
    "OHM": "Ohm",
    "NEW": "N",
    "NU": "N.m",
    "2A": "rad/s",
    "D81": "uT",
    "MLT": "mL",
    "L2": "L/min",
    "C62": "1",
    "": "1",
}
CODE_OF_UCUM: Final = {ucum: code for code, ucum in UCUM_OF_SIGNAL.items() if ucum not in {"/min", "1"}} | {
    "/min": "C94",
    "1": "",
}
_NAME_OF: Final = (
    {(LOINC, code): name for name, codings in _LOINC_OF.items() for code, _ in codings}
    | {(MDC, code): name for name, (code, _) in _MDC_OF.items()}
    | {
        (MDC, _MDC_HEART_RATE[0]): FeatureName.HEART_RATE,
        (MDC, _MDC_PULSE_RATE[0]): FeatureName.HEART_RATE,
    }
)


def codings_of(feature: Feature) -> list[dict[str, Any]]:
    """Return the codes of a feature; the last one is ours."""
    codings = [
        {"system": LOINC, "code": code, "display": display}
        for code, display in _LOINC_OF.get(feature.name, ())
    ]
    mdc = _MDC_OF.get(feature.name)
    if feature.name is FeatureName.HEART_RATE:
        is_ecg, is_ppg = "ecg" in feature.method.lower(), "ppg" in feature.method.lower()
        if is_ecg is not is_ppg:  # of a mixture and of a radar there is no code of the method
            mdc = _MDC_HEART_RATE if is_ecg else _MDC_PULSE_RATE
    if mdc is not None:
        codings.append({"system": MDC, "code": mdc[0], "display": mdc[1]})
    return [*codings, {"system": LOCAL, "code": feature.name.value}]


def feature_name_of(observation: Mapping[str, Any]) -> FeatureName:
    """Return the feature that an Observation has; raise `ExchangeError` if none is known."""
    codings = observation["code"].get("coding", [])
    for coding in codings:
        if coding.get("system") == LOCAL and coding.get("code") in set(FeatureName):
            return FeatureName(coding["code"])
    for coding in codings:
        name = _NAME_OF.get((coding.get("system", ""), coding.get("code", "")))
        if name is not None:
            return name
    codes = ", ".join(f"{coding.get('system')} {coding.get('code')}" for coding in codings) or "none"
    raise ExchangeError(f"an Observation has the codes {codes}; none is a feature that is known here")


def category_of(name: FeatureName) -> dict[str, Any]:
    """Return the category of the Observations of a feature."""
    is_activity = name in _ACTIVITIES
    code = "vital-signs" if name in _VITAL else "activity" if is_activity else "procedure"
    return {"coding": [{"system": CATEGORY, "code": code}]}
