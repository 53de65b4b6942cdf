"""What is known of one person while the consent lasts: state, limit, and signals for the page.

Features have times in s since 1970; here they are on the monotonic clock: `monotonic - age`, with the age
never below 0. So a step of the wall clock makes no old value fresh.
"""

import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from handover.messages import message
from handover_body.fusion.person_state import FusedValue, PersonState, fused
from handover_body.fusion.plausibility import stale_after_s
from handover_body.limits.body_limit import RADAR_TIMEOUT_S, TIMEOUT_S, BodyLimit, HeartRate
from handover_body.limits.curve import LimitCurve
from handover_body.limits.strain import Strain
from handover_body.metrics import DELAY, FEATURES, LIMIT_STOPS
from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import (
    EYE_EVENTS,
    EYE_STREAMS,
    LinkState,
    Samples,
    SensorFault,
    SensorReport,
    SignalInfo,
    SignalKind,
)
from handover_body.monitoring.activities import ANALYSIS
from handover_body.people.consent import Purpose
from handover_body.people.people import Person
from handover_body.processing.adl.classifier import AdlClassifier
from handover_body.processing.events import PersonAnalysis
from handover_body.processing.pipeline import SignalPipeline

MAX_WAITING: Final = 256
"""Packets that wait for a page that does not read; the oldest are dropped."""
RADAR: Final = "radar"
CONTACT_PERIOD_S: Final = 1.0
WORN, NOT_WORN = "worn", "notWorn"
FAULT_SHOWN_S: Final = 10.0
"""A fault is shown for so long after it has ended."""

_OF_ALL_STREAMS: Final = frozenset({SensorFault.GAP, SensorFault.LATE, SensorFault.CLOCK_JUMP})

ClassifierOf = Callable[[], AdlClassifier | None]
PipelineOf = Callable[[SignalInfo, Collection[SignalKind]], SignalPipeline]


@dataclass(slots=True)
class SensorView:
    """What is known of a sensor."""

    link: LinkState | None = None
    battery: float | None = None
    has_contact: bool | None = None
    contact_at_s: float = 0.0
    """When the device last said whether it touches the body."""
    fault: SensorReport | None = None
    fault_at_s: float = 0.0
    """Monotonic, as all times here."""
    good_at_s: float = 0.0
    """When usable samples were received last."""
    text: str = ""
    """Why the link is as it is."""
    kinds: frozenset[SignalKind] = frozenset()
    """The signals that its driver sends."""
    signals: dict[str, SignalInfo] = field(default_factory=dict)
    """Those that were received."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Signals and channels of which nothing is computed, with the reason."""

    def take_contact(self, *, is_touching: bool) -> None:
        """Take whether the device touches the body."""
        self.has_contact, self.contact_at_s = is_touching, time.monotonic()

    def take_fault(self, report: SensorReport, now_s: float) -> None:
        """Take a fault that lasts, or begins."""
        self.fault, self.fault_at_s = report, now_s

    def present_fault(self, now_s: float) -> SensorReport | None:
        """Return the last fault while it lasts, and for some seconds: people look up later."""
        is_over = self.good_at_s > self.fault_at_s and now_s - self.fault_at_s > FAULT_SHOWN_S
        return None if is_over else self.fault


class PersonMonitor:
    """The state and the limit of one person. Everything happens on the event loop."""

    def __init__(
        self, person: Person, pipeline_of: PipelineOf, classifier_of: ClassifierOf = lambda: None
    ) -> None:
        now_s = time.monotonic()
        self.person = person
        self.state = PersonState()
        self.strain = Strain()
        self.sensors: dict[str, SensorView] = {}
        self.limit = BodyLimit(_curve(person), now_s, now_s)
        if person.limit.is_stopped:
            self.limit = replace(self.limit, fraction=0.0, is_stopped=True)
        self._listeners: dict[int, deque[Samples]] = {}
        """By identity: two queues with the same packets are different ones."""
        self.recent: deque[Feature] = deque(maxlen=2048)
        """Heart rates of the last minutes, for measured baselines."""
        self.taps: set[Callable[[Samples | Feature | SensorReport], None]] = set()
        """Called with all samples, reports and values of sensors, with times in s since 1970."""
        self.on_lowered: Callable[[PersonMonitor], None] = lambda _: None
        """Called as soon as a heart rate has lowered the limit: that waits for no tick."""
        self.recording: str | None = None
        """The recording that runs."""
        self.was_lasting = False
        """Whether the strain was lasting when it was last looked at."""
        self._pipeline_of = pipeline_of
        self._pipelines: dict[tuple[str, SignalInfo], SignalPipeline | None] = {}
        self._analysis = _analysis(person)
        self._classifier_of = classifier_of
        self._classifier: AdlClassifier | None = None
        self._activity_signals: set[SignalKind] = set()

    def change(self, person: Person) -> None:
        """Take changes of the person; sensors that were taken away are forgotten."""
        if person.limit != self.person.limit:
            curve = _curve(person)
            self.limit = replace(self.limit, curve=curve)
        if person.baseline != self.person.baseline:
            self._analysis = _analysis(person)
        for gone in self.person.sensors.keys() - person.sensors.keys():
            self.forget(gone)
        self.person = person

    def forget(self, sensor: str) -> None:
        """Delete what is known of a sensor."""
        self.state.forget(sensor)
        self.sensors.pop(sensor, None)
        self._pipelines = {key: value for key, value in self._pipelines.items() if key[0] != sensor}

    def take(self, item: Samples | SensorReport) -> None:
        """Take what a driver sends. Nothing is taken without consent."""
        if Purpose.LIVE not in self.person.purposes() or item.source not in self.person.sensors:
            return
        sensor = self.sensors.setdefault(item.source, SensorView())
        if isinstance(item, Samples) and not len(item.values):  # news for the analysis, and no samples
            self._analyse(item, sensor)
            return
        self._tap(item)
        if isinstance(item, SensorReport):
            self._take_report(item, sensor)
            return
        sensor.signals[item.info.kind] = item.info
        if item.has_contact is not None:
            sensor.take_contact(is_touching=item.has_contact)
        if item.quality > 0:
            sensor.good_at_s = time.monotonic()
        for waiting in self._listeners.values():
            waiting.append(item)
        self._analyse(item, sensor)
        self._take_activity(item)

    def _analyse(self, item: Samples, sensor: SensorView) -> None:
        pipeline = self._pipeline(item, sensor)
        if pipeline is not None:
            self._take_features(pipeline.feed(item))
            self._take_failures(pipeline, sensor)

    def _take_activity(self, item: Samples) -> None:
        """Classify what the person does, from a wrist and a seat together."""
        if not AdlClassifier.accepts(item.info):
            return
        self._activity_signals.add(item.info.kind)
        if self._classifier is None and len(self._activity_signals) > 1:
            self._classifier = self._classifier_of()
        if self._classifier is not None:
            self._take_features(self._classifier.feed(item))

    def _pipeline(self, item: Samples, sensor: SensorView) -> SignalPipeline | None:
        """Return the pipeline of a signal; None for one that cannot be analysed."""
        key = item.source, item.info
        if key not in self._pipelines:
            try:
                self._pipelines[key] = self._pipeline_of(item.info, sensor.kinds)
            except ValueError as error:
                self._pipelines[key] = None
                reason = message(
                    "health.signal.not_analysed", "it cannot be analysed: {reason}", reason=str(error)[:300]
                )
                sensor.left_out[_name_of(item.info)] = reason
        return self._pipelines[key]

    def _take_failures(self, pipeline: SignalPipeline, sensor: SensorView) -> None:
        """Show which processors of a pipeline have failed."""
        for report in pipeline.take_reports():
            self._tap(report)
            sensor.text = report.text

    def _take_report(self, report: SensorReport, sensor: SensorView) -> None:
        sensor.link = report.link or sensor.link
        sensor.battery = sensor.battery if report.battery is None else report.battery
        if report.has_contact is not None:
            sensor.take_contact(is_touching=report.has_contact)
        if report.fault is not None:
            sensor.take_fault(report, time.monotonic())
        elif report.text or report.link is not None:
            sensor.text = report.text
        self.state.report(report)
        for (source, info), pipeline in self._pipelines.items():
            if source == report.source and pipeline is not None:
                self._take_features(pipeline.report(_concerning(info, report)))
        if self._classifier is not None:
            self._take_features(self._classifier.report(report))

    def _take_features(self, features: Sequence[Feature]) -> None:
        wall_s, now_s = time.time(), time.monotonic()
        for feature in (*features, *self._analysis.take(features)):
            self._tap(feature)
            age_s = max(wall_s - feature.at_s, 0.0)
            accepted = self.state.take(replace(feature, at_s=now_s - age_s), now_s)
            if accepted is None:
                continue
            FEATURES.labels(feature.name, accepted.status).inc()
            if accepted.name is FeatureName.HEART_RATE and accepted.status is Status.VALID:
                self.recent.append(accepted)
                DELAY.observe(age_s)
                before = self.limit.fraction
                self.step(now_s)
                if self.limit.fraction < before:
                    self.on_lowered(self)

    def _tap(self, item: Samples | Feature | SensorReport) -> None:
        for tap in tuple(self.taps):
            tap(item)

    def step(self, now_s: float) -> None:
        """Compute the limit at `now_s` (monotonic)."""
        value = self.heart_rate(now_s)
        has_fault = self.state.has_fault(FeatureName.HEART_RATE, now_s)
        before = self.limit.is_stopped
        self.limit = self.limit.step(value, now_s, has_fault=has_fault)
        if self.limit.is_stopped and not before:
            LIMIT_STOPS.inc()
        if value is not None:
            self.strain = self.strain.take(self.person.baseline.exertion(value.bpm), value.at_s)

    def heart_rate(self, now_s: float) -> HeartRate | None:
        """Return the heart rate that may feed the limit."""
        value = self.state.for_limits(FeatureName.HEART_RATE, now_s)
        if value is None:
            return None
        is_radar = all(RADAR in sensor.method for sensor in value.sensors)
        timeout_s = RADAR_TIMEOUT_S if is_radar else TIMEOUT_S
        return HeartRate(float(value.value), value.at_s, value.period_s, timeout_s)

    def values(self, now_s: float) -> list[FusedValue]:
        """Return all features of the person now; the exertion follows from heart rate and baseline."""
        features = self.state.values(now_s)
        if worn := self._worn(now_s):
            features.append(fused(FeatureName.WEAR_STATE, worn))
        rate = self.state.for_limits(FeatureName.HEART_RATE, now_s)
        if rate is not None and all(feature.name is not FeatureName.EXERTION_LEVEL for feature in features):
            exertion = self.person.baseline.exertion(float(rate.value))
            features.append(
                replace(
                    rate,
                    name=FeatureName.EXERTION_LEVEL,
                    value=exertion,
                    method="heart rate reserve",
                    sensors=(),
                )
            )
        return features

    def _worn(self, now_s: float) -> list[Feature]:
        """Return of each sensor that measures it whether it is worn."""
        return [
            Feature(
                FeatureName.WEAR_STATE,
                name,
                WORN if sensor.has_contact else NOT_WORN,
                sensor.contact_at_s,
                1.0,
                Status.STALE
                if now_s - sensor.contact_at_s > stale_after_s(CONTACT_PERIOD_S)
                else Status.VALID,
                "contact",
                period_s=CONTACT_PERIOD_S,
            )
            for name, sensor in self.sensors.items()
            if sensor.has_contact is not None
        ]

    def reset(self) -> None:
        """End a stop, by a person. Raises `RefusedReset`."""
        now_s = time.monotonic()
        self.step(now_s)
        self.limit = self.limit.reset(now_s)

    def listen(self) -> deque[Samples]:
        """Return a queue of samples from now on; end it with `end_listening`."""
        waiting: deque[Samples] = deque(maxlen=MAX_WAITING)
        self._listeners[id(waiting)] = waiting
        return waiting

    def end_listening(self, waiting: deque[Samples]) -> None:
        """Add nothing more to a queue of `listen`."""
        self._listeners.pop(id(waiting), None)


def _name_of(info: SignalInfo) -> str:
    return f"{info.kind} ({info.method})" if info.method else str(info.kind)


def _concerning(info: SignalInfo, report: SensorReport) -> SensorReport:
    """Return a report as it concerns a signal: a gap of the gaze is one of the events of the eyes, too."""
    if info.kind in EYE_EVENTS and report.kind in EYE_STREAMS and report.fault in _OF_ALL_STREAMS:
        return replace(report, kind=info.kind)
    return report


def _analysis(person: Person) -> PersonAnalysis:
    return PersonAnalysis(ANALYSIS, person.baseline.rest_bpm, person.baseline.maximum_bpm)


def _curve(person: Person) -> LimitCurve:
    limit = person.limit
    return LimitCurve(limit.free_bpm, limit.strained_bpm, limit.least)
