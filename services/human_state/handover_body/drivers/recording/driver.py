"""Replays a recording as a sensor: at its pace or faster, once or in a loop."""

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from handover_body.drivers.base import DriverSettings, SensorDriver, Sink, now_s
from handover_body.drivers.recording.channels import Meaning
from handover_body.drivers.recording.tracks import Recording, Track, read
from handover_body.model.signals import ClockKind, LinkState, Samples, SensorReport, SignalInfo, SignalKind


class ChannelSettings(DriverSettings):
    """What a channel is. `unit` replaces that of the file."""

    kind: SignalKind
    unit: str | None = None


class RecordingSettings(DriverSettings):
    """Which recording, and how it is replayed."""

    path: Path
    channels: dict[str, ChannelSettings] = Field(default_factory=dict)
    """The channels to replay, by their name in the file; empty: all whose kind is clear."""
    pace: float = Field(1.0, ge=0)
    """How many times faster than it was recorded; 0: as fast as possible."""
    loop: bool = False
    times: Literal["now", "recorded"] = "now"
    """Whether samples are stamped as if they were measured now, or as they were."""
    packet_s: Annotated[float, Field(gt=0, le=10)] = 0.25


class RecordingDriver(SensorDriver):
    """A sensor whose samples are in a file. The file is read and checked when the driver is made."""

    settings_model = RecordingSettings

    def __init__(self, source: str, settings: RecordingSettings) -> None:
        super().__init__(source, settings)
        meanings = {name: Meaning(meaning.kind, meaning.unit) for name, meaning in settings.channels.items()}
        self.recording: Recording = read(settings.path, meanings)
        self._tracks = distinct_tracks(self.recording.tracks)

    @property
    def left_out(self) -> Mapping[str, str]:
        return {track.name: track.reason for track in self.recording.left_out}

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        return tuple(track.info for track in self._tracks)

    async def run(self, sink: Sink) -> None:
        settings: RecordingSettings = self.settings
        sink(SensorReport(self.source, now_s(), link=LinkState.CONNECTED))
        recorded_s = self.recording.began_s if settings.times == "recorded" else None
        began_s = now_s() if recorded_s is None else recorded_s
        while True:
            await self._replay(sink, began_s)
            if not settings.loop:
                return
            # One period between the last sample and the first of the next round, so that it is no gap.
            began_s += self.recording.duration_s

    async def _replay(self, sink: Sink, began_s: float) -> None:
        settings: RecordingSettings = self.settings
        loop = asyncio.get_running_loop()
        started, elapsed_s = loop.time(), 0.0
        sent = [0] * len(self._tracks)
        while elapsed_s < self.recording.duration_s:
            elapsed_s += settings.packet_s
            due = started + elapsed_s / settings.pace if settings.pace else 0.0
            await asyncio.sleep(max(0.0, due - loop.time()) if settings.pace else 0.0)
            for at, track in enumerate(self._tracks):
                end = count_before(track, elapsed_s)
                if end > sent[at]:
                    for run in track.runs(sent[at], end):
                        sink(samples_of(self.source, track, *run, began_s))
                    sent[at] = end


def samples_of(source: str, track: Track, first: int, end: int, began_s: float) -> Samples:
    """Return the samples `first` to `end` of a track, between which is no gap."""
    start_s, times_s = began_s + track.start_s, None
    if track.times_s is None:
        start_s += first / (track.info.rate_hz or 1.0)
    elif track.info.rate_hz is None:
        times_s = began_s + track.times_s[first:end]
        start_s = float(times_s[0])
    else:
        start_s = began_s + float(track.times_s[first])
    return Samples(source, track.info, start_s, track.values[first:end], times_s, ClockKind.RECORDING)


def count_before(track: Track, elapsed_s: float) -> int:
    """Return how many samples of a track were taken before a time after the beginning."""
    if track.times_s is not None:
        return int(np.searchsorted(track.times_s, elapsed_s, side="left"))
    count = int(np.ceil((elapsed_s - track.start_s) * (track.info.rate_hz or 1.0) - 1e-9))
    return max(0, min(count, len(track.values)))


def distinct_tracks(tracks: tuple[Track, ...]) -> list[Track]:
    """Return the tracks with infos that differ, so that each is a signal of its own."""
    seen: dict[SignalInfo, int] = {}
    distinct = []
    for track in tracks:
        number = seen[track.info] = seen.get(track.info, 0) + 1
        info = track.info if number == 1 else replace(track.info, method=f"{track.info.method} ({number})")
        distinct.append(replace(track, info=info))
    return distinct
