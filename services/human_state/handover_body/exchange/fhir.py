"""Features and waveforms as HL7 FHIR R5 Observations, sessions as a Bundle, and back.

The subject is a pseudonym, as an identifier: no name, no address. An Observation whose value is stale or
implausible is `preliminary`, a valid one `final`.
"""

import math
import uuid
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Final

import numpy as np

from handover_body.exchange.fhir_codes import (
    CATEGORY,
    CODE_OF_UCUM,
    LOCAL,
    PSEUDONYM,
    SOURCE,
    UCUM,
    UCUM_OF,
    UCUM_OF_SIGNAL,
    category_of,
    codings_of,
    feature_name_of,
)
from handover_body.formats.errors import ExchangeError
from handover_body.formats.extra import required
from handover_body.formats.json_messages import Recorded
from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import Samples, SignalInfo, SignalKind

_NAMESPACE: Final = uuid.UUID("0d1c7c1e-5a1f-5d1b-9f0e-2f4f3a6b7c8d")
MAX_ENTRIES: Final = 1_000_000
MAX_WAVE_S: Final = 60.0


def observation_of(feature: Feature, subject: str) -> dict[str, Any]:
    """Return the Observation of a feature as JSON, checked by `fhir.resources`.

    Raises `ExchangeError`, also for a number that is not finite: it has no place in FHIR.
    """
    if not isinstance(feature.value, str) and not math.isfinite(feature.value):
        raise ExchangeError(f"{feature.name} of {feature.source} is {feature.value}; leave it out")
    at = _time(feature.at_s)
    when: dict[str, Any] = {"effectiveDateTime": at}
    if feature.window_s > 0:
        when = {"effectivePeriod": {"start": _time(feature.at_s - feature.window_s), "end": at}}
    value: dict[str, Any]
    if isinstance(feature.value, str):
        value = {"valueString": feature.value}
    else:
        value = {"valueQuantity": _quantity(feature.value, UCUM_OF.get(feature.name, "1"))}
    written = {
        "resourceType": "Observation",
        "id": _id(subject, feature.source, feature.name.value, repr(feature.at_s)),
        "status": "final" if feature.status is Status.VALID else "preliminary",
        "category": [category_of(feature.name)],
        "code": {"coding": codings_of(feature), "text": feature.name.value},
        "subject": _reference("Patient", PSEUDONYM, subject),
        **when,
        **value,
        "device": _reference("Device", SOURCE, feature.source),
        "component": [
            _component("quality", {"valueQuantity": _quantity(feature.quality, "1")}),
            _component("status", {"valueString": feature.status.value}),
            _component("calibrated", {"valueBoolean": feature.is_calibrated}),
        ],
    }
    if feature.method:
        written["method"] = {"text": feature.method}
    return _checked(written)


def feature_of(observation: Mapping[str, Any]) -> Feature:
    """Return the feature of an Observation (JSON), ours or that of another system.

    Of another system the status is `implausible` and the quality 0, since FHIR does not require them: such
    a value raises no limit. Raises `ExchangeError` for an unknown code, another unit, and a missing value
    or time.
    """
    checked = _checked(observation)
    name = feature_name_of(checked)
    components = {
        coding["code"]: component
        for component in checked.get("component", [])
        for coding in component["code"].get("coding", [])
        if coding.get("system") == LOCAL and "code" in coding
    }
    value = _value(checked, name)
    start_s, end_s = _effective(checked)
    quality = float(components.get("quality", {}).get("valueQuantity", {}).get("value", 0.0))
    status = components.get("status", {}).get("valueString", Status.IMPLAUSIBLE.value)
    if status not in set(Status) or not 0 <= quality <= 1:
        raise ExchangeError(
            f"an Observation has the status {status!r} and the quality {quality}; both are ours"
        )
    return Feature(
        name=name,
        source=_identified(checked.get("device"), SOURCE),
        value=value,
        at_s=end_s,
        quality=quality,
        status=Status(status),
        method=checked.get("method", {}).get("text", ""),
        window_s=end_s - start_s,
        is_calibrated=bool(components.get("calibrated", {}).get("valueBoolean", True)),
    )


def waveform_of(samples: Samples, subject: str) -> dict[str, Any]:
    """Return the Observation with the sampled data of a signal that has a rate, as JSON.

    The samples of one time follow each other, as FHIR says; `E` is a sample that could not be measured.
    Raises `ExchangeError` for a signal without a rate or in a unit that has no UCUM code here.
    """
    info = samples.info
    if info.rate_hz is None:
        raise ExchangeError(f"{info.kind} of {samples.source} has no rate, and sampled data needs one")
    if info.unit not in UCUM_OF_SIGNAL:
        raise ExchangeError(f"{info.unit} of {info.kind} has no UCUM code here; convert it")
    flat = samples.values.ravel().tolist()
    sampled: dict[str, Any] = {
        "origin": _quantity(0.0, UCUM_OF_SIGNAL[info.unit]),
        "interval": 1000.0 / info.rate_hz,
        "intervalUnit": "ms",
        "dimensions": len(info.channels),
        "data": " ".join(repr(value) if math.isfinite(value) else "E" for value in flat),
    }
    code: dict[str, Any] = {"coding": [{"system": LOCAL, "code": f"signal-{info.kind.value}"}]}
    code["text"] = ", ".join(info.channels) if any(info.channels) else info.kind.value
    written = {
        "resourceType": "Observation",
        "id": _id(subject, samples.source, info.kind.value, repr(samples.start_s)),
        "status": "final",
        "category": [{"coding": [{"system": CATEGORY, "code": "procedure"}]}],
        "code": code,
        "subject": _reference("Patient", PSEUDONYM, subject),
        "effectivePeriod": {"start": _time(samples.start_s), "end": _time(samples.end_s)},
        "valueSampledData": sampled,
        "device": _reference("Device", SOURCE, samples.source),
        "component": [
            _component("quality", {"valueQuantity": _quantity(samples.quality, "1")}),
            _component("unit", {"valueString": info.unit or "1"}),
            *(_component("channel", {"valueString": label}) for label in info.channels if label),
        ],
    }
    if info.method:
        written["method"] = {"text": info.method}
    return _checked(written)


def samples_of(observation: Mapping[str, Any]) -> Samples:
    """Return the samples of an Observation that `waveform_of` wrote. Raises `ExchangeError`."""
    checked = _checked(observation)
    codes = [coding.get("code", "") for coding in checked["code"].get("coding", [])]
    kinds = [code.removeprefix("signal-") for code in codes if code.startswith("signal-")]
    sampled = checked.get("valueSampledData")
    if not kinds or kinds[0] not in set(SignalKind) or sampled is None:
        raise ExchangeError("an Observation is no waveform of a signal that is known here")
    components = [
        (component["code"]["coding"][0]["code"], component) for component in checked.get("component", [])
    ]
    unit = next((part["valueString"] for name, part in components if name == "unit"), None)
    dimensions = int(sampled["dimensions"])
    labels = [part["valueString"] for name, part in components if name == "channel"]
    quality = next((part["valueQuantity"]["value"] for name, part in components if name == "quality"), 0.0)
    origin, factor = float(sampled["origin"].get("value", 0)), float(sampled.get("factor", 1))
    try:
        numbers = [
            math.nan if word in {"E", "U", "L"} else origin + factor * float(word)
            for word in sampled.get("data", "").split()
        ]
        values = np.array(numbers, np.float64).reshape(-1, dimensions)
    except ValueError as error:
        raise ExchangeError(f"the data of an Observation cannot be read: {error}") from None
    milliseconds = {"ms": 1.0, "s": 1000.0, "us": 1e-3}.get(sampled["intervalUnit"])
    if milliseconds is None or not sampled.get("interval"):
        raise ExchangeError("sampled data needs an interval in s, ms or us")
    written_unit = unit or CODE_OF_UCUM.get(sampled["origin"].get("code", "1"), "")
    info = SignalInfo(
        SignalKind(kinds[0]),
        "" if written_unit == "1" else written_unit,
        1000.0 / (float(sampled["interval"]) * milliseconds),
        tuple(labels) if len(labels) == dimensions else ("",) * dimensions,
        method=checked.get("method", {}).get("text", ""),
    )
    return Samples(
        _identified(checked.get("device"), SOURCE),
        info,
        _effective(checked)[0],
        values,
        quality=float(quality),
    )


def bundle_of(observations: Iterable[Mapping[str, Any]], session: str, at_s: float) -> dict[str, Any]:
    """Return a Bundle (a collection) of Observations of a session, checked by `fhir.resources`.

    `session` is the id of the PhysiologicalSession, `at_s` the time of the export. An Observation that occurs
    twice is there once. Raises `ExchangeError` beyond `MAX_ENTRIES`.
    """
    return _bundle((_checked(observation) for observation in observations), session, at_s)


def _bundle(observations: Iterable[Mapping[str, Any]], session: str, at_s: float) -> dict[str, Any]:
    """Return a Bundle of Observations that were checked; checking all of them again would double the cost."""
    entries: dict[str, dict[str, Any]] = {}
    for observation in observations:
        entries[str(observation["id"])] = {
            "fullUrl": f"urn:uuid:{observation['id']}",
            "resource": dict(observation),
        }
        if len(entries) > MAX_ENTRIES:
            raise ExchangeError(f"a Bundle has at most {MAX_ENTRIES:,} entries; export a shorter time")
    every = list(entries.values())
    bundle = _checked({
        "resourceType": "Bundle",
        "identifier": {"system": "urn:ietf:rfc:3986", "value": session},
        "type": "collection",
        "timestamp": _time(at_s),
        "entry": every[:1],
    })  # fmt: skip
    return bundle | {"entry": every}


def session_bundle(
    items: Iterable[Recorded], subject: str, session: str, at_s: float
) -> tuple[dict[str, Any], int]:
    """Return the Bundle of a recording, and how many of its signals and features FHIR cannot hold.

    These are features that are not finite, and signals without a rate or with a unit without a UCUM code.
    Reports of sensors and markers are no observations of the person and are not counted. The packets of a
    signal become Observations of up to `MAX_WAVE_S` each.
    """
    observations: list[dict[str, Any]] = []
    left_out = 0
    for item in _joined(items):
        if isinstance(item, Feature):
            is_written = isinstance(item.value, str) or math.isfinite(item.value)
            if is_written:
                observations.append(observation_of(item, subject))
        elif isinstance(item, Samples):
            is_written = item.info.rate_hz is not None and item.info.unit in UCUM_OF_SIGNAL
            if is_written:
                observations.append(waveform_of(item, subject))
        else:
            continue
        left_out += not is_written
    return _bundle(observations, session, at_s), left_out


def _joined(items: Iterable[Recorded]) -> Iterator[Recorded]:
    """Join packets of a signal that continue each other; samples stay within half a period of their times."""
    waves: dict[tuple[str, SignalInfo], list[Samples]] = {}
    counts: dict[tuple[str, SignalInfo], int] = {}
    for item in items:
        if not isinstance(item, Samples) or item.info.rate_hz is None:
            yield item
            continue
        key = (item.source, item.info)
        parts = waves.setdefault(key, [])
        if parts and not _continues(parts[0], counts[key], item, item.info.rate_hz):
            yield _one_of(parts)
            parts.clear()
        counts[key] = (counts[key] if parts else 0) + len(item.values)
        parts.append(item)
    for parts in waves.values():
        yield _one_of(parts)


def _continues(first: Samples, count: int, following: Samples, rate_hz: float) -> bool:
    return (
        abs(following.start_s - first.start_s - count / rate_hz) <= 0.5 / rate_hz
        and count + len(following.values) <= MAX_WAVE_S * rate_hz
        and (following.quality, following.has_contact) == (first.quality, first.has_contact)
    )


def _one_of(parts: list[Samples]) -> Samples:
    return replace(parts[0], values=np.vstack([part.values for part in parts])) if parts[1:] else parts[0]


def read_bundle(bundle: Mapping[str, Any]) -> tuple[list[Feature], list[Samples]]:
    """Return features and waveforms of a Bundle (JSON), without other resources. Raises `ExchangeError`."""
    features: list[Feature] = []
    waves: list[Samples] = []
    for entry in _checked(bundle).get("entry", []):
        resource = entry.get("resource", {})
        if resource.get("resourceType") != "Observation":
            continue
        if "valueSampledData" in resource:
            waves.append(samples_of(resource))
        else:
            features.append(feature_of(resource))
    return features, waves


def _checked(resource: Mapping[str, Any]) -> dict[str, Any]:
    """Return the resource as `fhir.resources` (R5) reads and writes it."""
    kind = resource.get("resourceType")
    if kind not in {"Observation", "Bundle"}:
        raise ExchangeError(f"a resource is a {kind}; it must be an Observation or a Bundle")
    module: Any = required(f"fhir.resources.{kind.lower()}")
    try:
        checked: dict[str, Any] = getattr(module, kind).model_validate(resource).model_dump(mode="json")
    except ValueError as error:  # the validation error of pydantic
        raise ExchangeError(f"a resource is no {kind} of FHIR R5: {error}") from None
    return checked


def _value(observation: Mapping[str, Any], name: FeatureName) -> float | str:
    if "valueString" in observation:
        return str(observation["valueString"])
    quantity = observation.get("valueQuantity")
    if quantity is None or "value" not in quantity:
        raise ExchangeError(f"the Observation of {name} has no valueQuantity and no valueString")
    expected = UCUM_OF.get(name, "1")
    code = quantity.get("code", expected)
    if code != expected and not (
        code.startswith("{") and code.endswith(("}", "}/min")) and _same(code, expected)
    ):
        raise ExchangeError(f"{name} is in {code}, but must be in {expected}; convert it")
    return float(quantity["value"])


def _same(code: str, expected: str) -> bool:
    """Return whether a unit differs by its annotation alone: `{beat}/min` is `/min`."""
    return (code.partition("}")[2] or "1") == expected


def _effective(observation: Mapping[str, Any]) -> tuple[float, float]:
    period = observation.get("effectivePeriod")
    moments = [observation.get("effectiveDateTime")] * 2
    if period is not None:
        moments = [period.get("start") or period.get("end"), period.get("end") or period.get("start")]
    if moments[0] is None:
        raise ExchangeError("an Observation has no effective time, so its age is not known")
    try:
        start_s, end_s = (datetime.fromisoformat(str(moment)).timestamp() for moment in moments)
    except ValueError as error:
        raise ExchangeError(f"an Observation has the time {moments[1]}: {error}") from None
    return start_s, end_s


def _identified(reference: Mapping[str, Any] | None, system: str) -> str:
    identifier = (reference or {}).get("identifier", {})
    if identifier.get("system") == system:
        return str(identifier.get("value", ""))
    return str(identifier.get("value") or (reference or {}).get("reference") or "fhir")


def _component(code: str, value: dict[str, Any]) -> dict[str, Any]:
    return {"code": {"coding": [{"system": LOCAL, "code": code}]}, **value}


def _quantity(value: float, ucum: str) -> dict[str, Any]:
    return {"value": value, "unit": ucum, "system": UCUM, "code": ucum}


def _reference(kind: str, system: str, value: str) -> dict[str, Any]:
    return {"type": kind, "identifier": {"system": system, "value": value}}


def _id(*parts: str) -> str:
    return str(uuid.uuid5(_NAMESPACE, "\0".join(parts)))


def _time(at_s: float) -> str:
    return datetime.fromtimestamp(at_s, UTC).isoformat(timespec="microseconds")
