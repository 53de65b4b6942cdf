"""All analysis of one signal of one sensor: its processors, and what a fault does to their values.

    processors = processors_for(info)       # none, or one pipeline: a `Processor`
    pipeline = pipeline_for(info)           # the same, also for a signal that nobody analyses
    features = pipeline.feed(samples)       # each packet
    features = pipeline.report(report)      # faults, lost contact and silence that the monitor found
    reports = pipeline.take_reports()       # processors that failed

`checks.monitor` has checked the samples: those without quality are not analysed, and a report stands between
samples that do not continue each other. A fault resets every processor, and each feature that was valid is
given out once more with quality 0, so that nobody keeps using it: as stale when the signal only ceased or
came late, else as implausible.

A package adds a processor with an entry point:

    [project.entry-points."handover.signal_processors"]
    my-gait = "my_gait:processor_for"

`processor_for(info: SignalInfo) -> Processor | None` returns a processor for the signals it understands. It
is called once per signal, after ours; a processor that raises is dropped with a report, the others stay.
"""

import importlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Final

from handover.extensions import ExtensionPoint
from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import SILENT, Samples, SensorReport, SignalInfo, SignalKind
from handover_body.processing.base import EventProcessor, Processor

SIGNAL_PROCESSORS: Final = ExtensionPoint("signal processor", "handover.signal_processors", {})

MAX_REPORTS: Final = 64
"""Reports that nobody takes; the oldest are dropped."""
_HERE: Final = "handover_body.processing"
OWN: Final[dict[SignalKind, tuple[str, ...]]] = {
    SignalKind.ECG: ("ecg:EcgProcessor",),
    SignalKind.PPG: ("pulse:PpgProcessor",),
    SignalKind.RESPIRATION: ("breathing:WaveBreathing",),
    SignalKind.EDA: ("skin_and_muscle:EdaProcessor",),
    SignalKind.EMG: ("skin_and_muscle:EmgProcessor",),
    SignalKind.INTER_BEAT_INTERVAL: ("intervals:IntervalProcessor",),
    SignalKind.ACCELERATION: ("motion:AccelerationProcessor",),
    SignalKind.PRESSURE_MAP: ("pressure:PressureProcessor",),
    SignalKind.BLINK: ("eyes:EyeEventProcessor",),
    SignalKind.FIXATION: ("eyes:EyeEventProcessor",),
    SignalKind.SACCADE: ("eyes:EyeEventProcessor",),
    SignalKind.GAZE: ("eyes:GazeProcessor",),
    SignalKind.EOG: ("eyes:EogProcessor",),
    SignalKind.EYE_STATE: ("eyes:PupilProcessor",),
}
"""Our processors by kind, imported when the first signal of the kind comes. Each takes the `SignalInfo`."""


def processors_for(info: SignalInfo, *, has_own: bool = True) -> tuple[Processor, ...]:
    """Return what analyses a signal: one pipeline, or nothing for a kind that nobody analyses.

    Without `has_own` only processors of other packages do.

    A signal that cannot be analysed, an ECG of 10 Hz for instance, has no processor either; `pipeline_for`
    raises the reason.
    """
    try:
        pipeline = pipeline_for(info, has_own=has_own)
    except ValueError:
        return ()
    return (pipeline,) if pipeline.has_processors else ()


def pipeline_for(info: SignalInfo, *, has_own: bool = True) -> "SignalPipeline":
    """Return the processors of one signal of one sensor, ours first.

    Raises `ValueError` if the signal cannot be analysed; the text says why.
    """
    processors: list[Processor] = []
    for place in OWN.get(info.kind, ()) if has_own else ():
        module, name = place.split(":")
        processors.append(getattr(importlib.import_module(f"{_HERE}.{module}"), name)(info))
    for name in SIGNAL_PROCESSORS.names():
        make: Callable[[SignalInfo], Processor | None] = SIGNAL_PROCESSORS.load(name)
        processor = make(info)
        if processor is not None:
            processors.append(processor)
    return SignalPipeline(info, processors)


class SignalPipeline:
    """The processors of one signal of one sensor. It is itself a `Processor`."""

    def __init__(self, info: SignalInfo, processors: Sequence[Processor]) -> None:
        self.info: Final = info
        # A pipeline among them gives its processors.
        self._processors: list[Processor] = []
        for processor in processors:
            self._processors += processor.processors if isinstance(processor, SignalPipeline) else [processor]
        self._valid: dict[FeatureName, Feature] = {}
        self._reports: deque[SensorReport] = deque(maxlen=MAX_REPORTS)

    @property
    def processors(self) -> list[Processor]:
        """Return what analyses this signal."""
        return list(self._processors)

    @property
    def has_processors(self) -> bool:
        """Return whether anything analyses this signal."""
        return bool(self._processors)

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take the next packet; return the features that it completes.

        An empty one, which says that nothing happened, is for each `EventProcessor`.
        """
        if not samples.quality > 0:
            return []
        if not len(samples.values):
            return self._each(
                lambda processor: _nothing_happened(processor, samples), samples.source, samples.end_s
            )
        return self._each(lambda processor: processor.feed(samples), samples.source, samples.end_s)

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Take news of the sensor: a fault of this signal, or lost contact, ends all values."""
        if report.fault is None and report.has_contact is not False:
            return []
        if report.kind not in {None, self.info.kind}:
            return []
        return self._end(report)

    def take_reports(self) -> list[SensorReport]:
        """Return the processors that failed since the last call."""
        taken = list(self._reports)
        self._reports.clear()
        return taken

    def _end(self, report: SensorReport) -> list[Feature]:
        status = Status.STALE if report.fault in SILENT else Status.IMPLAUSIBLE
        ended = [
            replace(feature, at_s=report.at_s, quality=0.0, status=status) for feature in self._valid.values()
        ]
        self._valid.clear()
        return ended + self._each(lambda processor: processor.report(report), report.source, report.at_s)

    def _each(
        self, call: Callable[[Processor], Sequence[Feature]], source: str, at_s: float
    ) -> list[Feature]:
        features: list[Feature] = []
        for processor in tuple(self._processors):
            try:
                features += call(processor)
            except Exception as error:  # noqa: BLE001 -- a processor of somebody else may fail in any way
                self._processors.remove(processor)
                name = type(processor).__name__
                text = f"the processor {name} of {self.info.kind} failed: {error!r}; it was dropped"
                self._reports.append(SensorReport(source, at_s, text=text))
        for feature in self._remembered(features):
            self._valid[feature.name] = feature
        return features

    def _remembered(self, features: list[Feature]) -> Iterator[Feature]:
        for feature in features:
            if feature.status is Status.VALID:
                yield feature
            else:
                self._valid.pop(feature.name, None)


def _nothing_happened(processor: Processor, samples: Samples) -> Sequence[Feature]:
    if samples.info.rate_hz is not None or not isinstance(processor, EventProcessor):
        return ()
    return processor.nothing_happened(samples.source, samples.start_s)
