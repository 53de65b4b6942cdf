"""Features as NGSI-LD entities, and how often an entity is written. Pure; the time is an argument.

The fused value of a feature is the default instance of an attribute, and each sensor has one with the
`datasetId` `urn:ngsi-ld:Dataset:<source>`. The broker receives at most one state a second of each person:
waveforms and control loops use other ways.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final
from urllib.parse import quote, unquote

from pydantic.alias_generators import to_snake

from handover_body.formats.errors import ExchangeError
from handover_body.fusion.person_state import FusedValue
from handover_body.model.features import UNITS, Feature, FeatureName, Status
from handover_datamodels import DataModelError, HumanState, Measurement, PhysiologicalSession, PressureMat
from handover_datamodels.times import iso

DATASET: Final = "urn:ngsi-ld:Dataset:"
FUSED: Final = "fused"
"""The source of a fused value that is read from an entity."""

_MAT: Final = frozenset(
    {
        FeatureName.CENTRE_OF_PRESSURE_X,
        FeatureName.CENTRE_OF_PRESSURE_Y,
        FeatureName.LOAD,
        FeatureName.ACTIVE_CELLS,
    }
)
OF_PERSON: Final = frozenset(name for name in FeatureName if to_snake(name) in HumanState.model_fields)
"""The features that a HumanState has; the others stay in streams and recordings."""

DEAD_BANDS: Final[Mapping[str, float]] = {
    "heartRate": 1.0,
    "breathingRate": 0.5,
    "hrvRmssd": 2.0,
    "hrvSdnn": 2.0,
    "spo2": 1.0,
    "edaTonic": 0.1,
    "skinTemperature": 0.1,
    "movement": 0.05,
    "bodyMovement": 5.0,
    "cadence": 1.0,
    "exertionLevel": 0.02,
    "fatigue": 0.05,
    "stress": 0.05,
    "blinkRate": 1.0,
    "blinkDuration": 10.0,
    "fixationDuration": 20.0,
    "saccadeRate": 0.2,
    "saccadeAmplitude": 0.5,
    "pupilDiameter": 0.1,
    "copX": 5.0,
    "copY": 5.0,
    "load": 0.05,
}
"""The smallest change of each attribute that is written, in its unit. Others are written at each change."""
QUALITY_BAND: Final = 0.2
MIN_INTERVAL_S: Final = 1.0
AT_LEAST_EVERY_S: Final = 10.0


def human_state(
    entity_id: str,
    person: str,
    values: Iterable[FusedValue],
    devices: Mapping[str, str] | None = None,
) -> HumanState:
    """Return the entity of a person from fused values; `devices` are the ids of Device entities by source.

    Values without an attribute in HumanState, and numbers that are not finite, are left out.
    """
    return HumanState.from_ngsild(
        {
            "id": entity_id,
            "type": "HumanState",
            "refPerson": {"type": "Relationship", "object": person},
            **_attributes((feature for feature in values if feature.name in OF_PERSON), devices or {}),
        }
    )


def pressure_mat(
    entity_id: str, device: str, values: Iterable[FusedValue], devices: Mapping[str, str] | None = None
) -> PressureMat:
    """Return the entity of a pressure mat from the fused values of its centre of pressure and load."""
    written = _attributes((feature for feature in values if feature.name in _MAT), devices or {})
    for instance in _instances(written.get("activeCells", [])):
        instance["value"] = round(instance["value"])
    return PressureMat.from_ngsild(
        {
            "id": entity_id,
            "type": "PressureMat",
            "refDevice": {"type": "Relationship", "object": device},
            **written,
        }
    )


def session(
    entity_id: str,
    person: str,
    start_s: float,
    *,
    end_s: float | None = None,
    recording: str | None = None,
    sha256: str | None = None,
) -> PhysiologicalSession:
    """Return the entity of a recording; times are in s since 1970."""
    return PhysiologicalSession(
        id=entity_id,
        ref_person=person,
        started_at=datetime.fromtimestamp(start_s, UTC),
        ended_at=None if end_s is None else datetime.fromtimestamp(end_s, UTC),
        recording=recording,
        sha256=sha256,
    )


def features_of(entity: HumanState | PressureMat) -> list[Feature]:
    """Return the values of an entity: of each attribute the fused one (source `fused`), then the sensors.

    An instance without `status` is `implausible` and one without `quality` has 0: what a stranger wrote
    raises no limit. Window and period are not in the entity and have their defaults. Raises `ExchangeError`.
    """
    features: list[Feature] = []
    for name in FeatureName:
        attribute = getattr(entity, to_snake(name), None)
        if not isinstance(attribute, Measurement):
            continue
        try:
            instances = attribute.instances()
        except ValueError as error:
            raise ExchangeError(f"{entity.id}: {name}: {error}") from None
        features += [_feature(entity.id, name, instance) for instance in instances]
    return features


def read_human_state(data: Mapping[str, Any]) -> HumanState:
    """Return the entity in `data`, in any form. Raises `ExchangeError`."""
    try:
        return HumanState.from_ngsild(data)
    except DataModelError as error:
        raise ExchangeError(str(error)) from None


def _attributes(values: Iterable[FusedValue], devices: Mapping[str, str]) -> dict[str, Any]:
    written: dict[str, Any] = {}
    for fused in values:
        sensors = [sensor for sensor in fused.sensors if _is_writable(sensor.value)]
        if not _is_writable(fused.value):
            continue
        default = _measurement(fused, None)
        if len(sensors) == 1 and sensors[0].source in devices:
            default["observedBy"] = {"type": "Relationship", "object": devices[sensors[0].source]}
        instances = [default]
        for sensor in sensors:
            instances.append(_measurement(sensor, devices.get(sensor.source)))
            instances[-1]["datasetId"] = dataset_id(sensor.source)
        written[fused.name.value] = instances if len(instances) > 1 else default
    return written


def only_fused(entity: Mapping[str, Any]) -> dict[str, Any]:
    """Return a normalized entity without the instances of sensors, for a broker that keeps one value each."""
    return {
        name: next((instance for instance in attribute if "datasetId" not in instance), attribute[0])
        if isinstance(attribute, list)
        and attribute
        and all(isinstance(instance, dict) for instance in attribute)
        else attribute
        for name, attribute in entity.items()
    }


def dataset_id(source: str) -> str:
    """Return the datasetId of a sensor."""
    return DATASET + quote(source, safe="")


def _measurement(value: FusedValue | Feature, device: str | None) -> dict[str, Any]:
    written: dict[str, Any] = {
        "type": "Property",
        "value": value.value,
        "observedAt": iso(datetime.fromtimestamp(value.at_s, UTC)),
        "quality": {"type": "Property", "value": min(max(value.quality, 0.0), 1.0)},
        "status": {"type": "Property", "value": value.status.value},
    }
    if (unit := UNITS.get(value.name)) is not None:
        written["unitCode"] = unit
    if value.method:
        written["method"] = {"type": "Property", "value": value.method}
    if device is not None:
        written["observedBy"] = {"type": "Relationship", "object": device}
    if not value.is_calibrated:
        written["calibrated"] = {"type": "Property", "value": False}
    return written


def _is_writable(value: float | str) -> bool:
    return isinstance(value, str) or math.isfinite(value)


def _feature(entity_id: str, name: FeatureName, measurement: Measurement[Any]) -> Feature:
    if measurement.observed_at is None:
        raise ExchangeError(f"{entity_id}: {name} has no observedAt, so its age is not known; write it")
    if measurement.unit_code is not None and measurement.unit_code != UNITS.get(name, measurement.unit_code):
        raise ExchangeError(
            f"{entity_id}: {name} is in {measurement.unit_code}, but must be in {UNITS[name]}; convert it"
        )
    source = FUSED
    if measurement.dataset_id is not None:
        source = unquote(measurement.dataset_id.removeprefix(DATASET))
    return Feature(
        name=name,
        source=source,
        value=measurement.value if isinstance(measurement.value, str) else float(measurement.value),
        at_s=measurement.observed_at.timestamp(),
        quality=0.0 if measurement.quality is None else float(measurement.quality.value),
        status=Status.IMPLAUSIBLE if measurement.status is None else Status(measurement.status.value.value),
        method="" if measurement.method is None else measurement.method.value,
        is_calibrated=measurement.calibrated is None or measurement.calibrated.value,
    )


def _instances(attribute: Any) -> list[dict[str, Any]]:
    return attribute if isinstance(attribute, list) else [attribute]


@dataclass(frozen=True, slots=True)
class _Sent:
    value: float | str
    quality: float
    status: Status


_Snapshot = dict[tuple[FeatureName, str], _Sent]


class EntityThrottle:
    """Decides when an entity of one person or mat is written: dead bands, and at most once in `interval_s`.

    Offer each new entity, and ask `due` at least once in each interval. A change of a status, and a sensor
    that comes or goes, is always a change. What is returned counts as written; after a failed write call
    `failed`. Without a change the entity is written every `at_least_every_s`, so that `observedAt` does not
    seem stale.
    """

    def __init__(
        self,
        interval_s: float = MIN_INTERVAL_S,
        at_least_every_s: float = AT_LEAST_EVERY_S,
        dead_bands: Mapping[str, float] = DEAD_BANDS,
    ) -> None:
        if not 0 < interval_s <= at_least_every_s:
            raise ValueError("interval_s must be above 0 and not above at_least_every_s")
        self._interval_s = interval_s
        self._at_least_every_s = at_least_every_s
        self._bands = dead_bands
        self._written: _Snapshot = {}
        self._written_at_s: float | None = None
        self._latest: HumanState | PressureMat | None = None
        self._must_write = False

    def offer(self, entity: HumanState | PressureMat, now_s: float) -> HumanState | PressureMat | None:
        """Take the newest entity; return it if it is to be written now."""
        self._latest = entity
        return self.due(now_s)

    def due(self, now_s: float) -> HumanState | PressureMat | None:
        """Return the newest entity if it is to be written now; None otherwise."""
        if self._latest is None or not self.is_open(now_s):
            return None
        since_s = self._since_s(now_s)
        snapshot = _snapshot(features_of(self._latest))
        # a clock that was set back must not silence the entity
        is_old = since_s < 0 or since_s >= self._at_least_every_s
        if not (is_old or self._must_write or self._has_changed(snapshot)):
            return None
        self._written, self._written_at_s, self._must_write = snapshot, now_s, False
        return self._latest

    def is_open(self, now_s: float) -> bool:
        """Return whether the interval has passed, so that an entity may be written."""
        return not 0 <= self._since_s(now_s) < self._interval_s

    def _since_s(self, now_s: float) -> float:
        return math.inf if self._written_at_s is None else now_s - self._written_at_s

    def failed(self) -> None:
        """Write the newest entity again after the interval, since the last write did not succeed."""
        self._must_write = True

    def _has_changed(self, snapshot: _Snapshot) -> bool:
        if snapshot.keys() != self._written.keys():
            return True
        return any(self._differs(key[0], value, self._written[key]) for key, value in snapshot.items())

    def _differs(self, name: FeatureName, value: _Sent, written: _Sent) -> bool:
        if value.status is not written.status or abs(value.quality - written.quality) >= QUALITY_BAND:
            return True
        if isinstance(value.value, str) or isinstance(written.value, str):
            return value.value != written.value
        change = abs(value.value - written.value)
        return change >= self._bands[name] if name in self._bands else change > 0


def _snapshot(features: Sequence[Feature]) -> _Snapshot:
    return {
        (feature.name, feature.source): _Sent(feature.value, feature.quality, feature.status)
        for feature in features
    }
