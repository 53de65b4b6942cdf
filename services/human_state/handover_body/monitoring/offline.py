"""Analyses a recording without a service: the checks, pipelines and plausibility of a sensor.

Packets, silence and faults are those of the driver `recording` at its pace; the clock is the recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from handover_body.checks.monitor import SignalMonitor
from handover_body.drivers.recording.channels import LeftOut, Meaning
from handover_body.drivers.recording.driver import count_before, distinct_tracks, samples_of
from handover_body.drivers.recording.tracks import Track, read
from handover_body.fusion.person_state import PersonState
from handover_body.model.features import Feature
from handover_body.model.signals import SensorReport
from handover_body.monitoring.processors import pipeline_of
from handover_body.processing.pipeline import SignalPipeline

PACKET_S: Final = 0.25
BEGIN_S: Final = 1_000_000_000.0


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel that was analysed."""

    name: str
    kind: str
    unit: str
    rate_hz: float | None
    samples: int


@dataclass(frozen=True, slots=True)
class Offline:
    """What the service would make of a recording. Features have their channel; times begin at `BEGIN_S`."""

    features: list[tuple[str, Feature]]
    channels: list[Channel]
    left_out: list[LeftOut]


@dataclass(slots=True)
class _Signal:
    track: Track
    monitor: SignalMonitor
    pipeline: SignalPipeline
    state: PersonState
    """Each channel is a sensor of its own, so that two leads are compared and not mixed."""
    sent: int = 0

    def until(self, elapsed_s: float) -> list[Feature]:
        """Feed what was measured until a time, and look for silence; return the features as shown."""
        end = count_before(self.track, elapsed_s)
        now_s = BEGIN_S + elapsed_s
        shown: list[Feature] = []
        for first, last in self.track.runs(self.sent, end) if end > self.sent else []:
            checked = self.monitor.take(samples_of("recording", self.track, first, last, BEGIN_S), now_s)
            for report in checked.reports:
                shown += self._reported(report, now_s)
            if checked.samples is not None:
                shown += self._taken(self.pipeline.feed(checked.samples), now_s)
        if end == self.sent and (silence := self.monitor.silence(now_s)) is not None:
            shown += self._reported(silence, now_s)
        self.sent = end
        return shown

    def _reported(self, report: SensorReport, now_s: float) -> list[Feature]:
        self.state.report(report)
        return self._taken(self.pipeline.report(report), now_s)

    def _taken(self, features: Sequence[Feature], now_s: float) -> list[Feature]:
        taken = (self.state.take(feature, now_s) for feature in features)
        return [feature for feature in taken if feature is not None]


def analyse(path: Path, meanings: dict[str, Meaning] | None = None) -> Offline:
    """Return what the service would make of a recording; raise `RecordingError`."""
    recording = read(path, meanings or {})
    left_out = list(recording.left_out)
    signals: list[_Signal] = []
    for track in distinct_tracks(recording.tracks):
        try:
            pipeline = pipeline_of(track.info, ())
        except ValueError as error:
            left_out.append(LeftOut(track.name, str(error)))
            continue
        if not pipeline.has_processors:
            left_out.append(LeftOut(track.name, f"nothing is computed from the kind {track.info.kind}"))
            continue
        signals.append(_Signal(track, SignalMonitor("recording", track.info), pipeline, PersonState()))
    features: list[tuple[str, Feature]] = []
    elapsed_s = 0.0
    while signals and elapsed_s < recording.duration_s:
        elapsed_s += PACKET_S
        for signal in signals:
            features += [(signal.track.name, feature) for feature in signal.until(elapsed_s)]
    channels = [
        Channel(
            info.track.name, info.track.info.kind, info.track.info.unit, info.track.info.rate_hz, info.sent
        )
        for info in signals
    ]
    return Offline(features, channels, left_out)
