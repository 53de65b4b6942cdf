"""One ROS 2 topic of `handover_human_msgs`, or of the eye tracker of ROS4HC, read from DDS directly.

Services do not depend on the bridge, and the broker has no waveforms; so the driver joins the ROS domain by
itself. Times are those of the publisher: they count as a device clock, mapped to ours.
"""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from handover.errors import UsageError
from handover.formats.ros_dds import MAX_DOMAIN, TopicEndpoints
from handover_body.drivers.base import (
    DriverSettings,
    FoundDevice,
    LinkLost,
    PacketError,
    SensorDriver,
    Sink,
    now_s,
)
from handover_body.drivers.ros_topic import ros4hc
from handover_body.drivers.ros_topic.messages import PACKAGE, as_message, fields_of, type_of
from handover_body.formats.errors import ExchangeError
from handover_body.formats.ros import samples_of
from handover_body.model.signals import (
    EYE_EVENTS,
    ClockKind,
    LinkState,
    Samples,
    SensorReport,
    SignalInfo,
    SignalKind,
)

TOPIC: Final = r"^/?[A-Za-z_][A-Za-z0-9_/]*$"
PULL_S: Final = 0.02
MAX_MESSAGES: Final = 256
READABLE: Final = frozenset(f"{PACKAGE}/msg/{fields_of(kind)[0]}" for kind in SignalKind) | {
    f"{ros4hc.PACKAGE}/msg/{name}" for name, _ in ros4hc.FIELDS.values()
}
Read = Callable[[dict[str, Any]], Samples | None]
EVENTS_SILENCE_S: Final = 120.0
"""A topic of events of the eyes may be silent for so long."""


class RosTopicSettings(DriverSettings):
    """The topic, and the signal that its messages must carry. `source` accepts one sensor of several.

    The messages of ROS4HC (`ros2_hc_msgs`) say neither unit nor channels, which follow from the kind.
    """

    topic: str = Field(pattern=TOPIC, max_length=200)
    kind: SignalKind
    messages: Literal["handover_human_msgs", "ros2_hc_msgs"] = "handover_human_msgs"
    unit: str = ""
    rate_hz: float | None = Field(None, gt=0, le=100_000)
    channels: tuple[str, ...] = ("",)
    domain: int = Field(0, ge=0, le=MAX_DOMAIN)
    source: str | None = None
    gaze_topic: str | None = Field(None, pattern=TOPIC, max_length=200)
    """Of events of the eyes: the gaze of the same tracker, so that staring is no silence."""

    @model_validator(mode="before")
    @classmethod
    def _follows_from_the_kind(cls, members: Any) -> Any:
        if not isinstance(members, dict) or members.get("messages", PACKAGE) == PACKAGE:
            if isinstance(members, dict) and "unit" not in members:
                raise ValueError("unit is missing: a code of UN/CEFACT Recommendation 20, or an empty text")
            return members
        kind = members.get("kind")
        signal = None if kind is None else ros4hc.SIGNALS.get(kind)
        if signal is None:
            kinds = ", ".join(ros4hc.SIGNALS)
            raise ValueError(f"kind must be one of {kinds} for messages of {ros4hc.PACKAGE}")
        if members.keys() & {"unit", "channels", "source"}:
            raise ValueError(
                f"leave out unit, channels and source: the messages of {ros4hc.PACKAGE} have fixed ones"
            )
        return {**members, "unit": signal[0], "channels": signal[1]}

    @model_validator(mode="after")
    def _gaze_is_for_events(self) -> "RosTopicSettings":
        if self.gaze_topic is not None and self.kind not in EYE_EVENTS:
            raise ValueError(
                f"gaze_topic is for {', '.join(sorted(EYE_EVENTS))}; leave it out for {self.kind}"
            )
        return self


class RosTopicDriver(SensorDriver):
    """One topic."""

    settings_model: ClassVar[type[DriverSettings]] = RosTopicSettings
    max_latency_s = 0.1
    stamps_oldest = True

    def __init__(self, source: str, settings: RosTopicSettings) -> None:
        super().__init__(source, settings)
        if settings.kind in EYE_EVENTS and settings.gaze_topic is None:
            self.max_silence_s = EVENTS_SILENCE_S

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        settings: RosTopicSettings = self.settings
        return (
            SignalInfo(
                settings.kind,
                settings.unit,
                settings.rate_hz,
                settings.channels,
                method=f"ROS {settings.topic}",
            ),
        )

    @classmethod
    async def discover(cls, timeout_s: float, domain: int = 0) -> list[FoundDevice]:
        """Return the topics of a domain whose messages it reads, with their type."""

        def opened() -> TopicEndpoints | None:
            try:
                return TopicEndpoints(domain)
            except (OSError, UsageError):
                return None

        endpoints = await asyncio.to_thread(opened)
        if endpoints is None:
            return []
        await asyncio.sleep(timeout_s)  # publishers become known one after the other
        return [
            FoundDevice(topic, type_name)
            for topic, type_name in endpoints.published()
            if type_name in READABLE
        ]

    async def run(self, sink: Sink) -> None:
        readers, failure = await asyncio.to_thread(self._open)
        sink(SensorReport(self.source, now_s(), link=LinkState.CONNECTED))
        while True:
            for reader, read in readers:
                try:
                    received = reader.take(N=MAX_MESSAGES)
                except failure as error:
                    raise LinkLost(f"DDS failed: {error}") from error
                for sample in received:
                    if type(sample).__name__ == "InvalidSample":
                        continue  # a publisher that left
                    try:
                        samples = read(as_message(sample))
                    except PacketError as error:
                        self.reject(sink, error)
                        continue
                    if samples is not None:
                        sink(samples)
            await asyncio.sleep(PULL_S)

    def read_gaze(self, message: dict[str, Any]) -> Samples | None:
        """Return an empty packet of the events: until this gaze nothing happened. None: it saw no eyes."""
        (info,) = self.signals
        try:
            if self._is_of_ros4hc:
                gaze = ros4hc.samples_of(ros4hc.GAZE, self.source, message)
            else:
                gaze = samples_of(_type_name(SignalKind.GAZE), message)
        except ExchangeError as error:
            raise PacketError(str(error)) from error
        is_other = gaze.info.kind is not SignalKind.GAZE or self.settings.source not in (None, gaze.source)
        if is_other or not gaze.quality > 0 or not np.isfinite(gaze.values).all():
            return None
        empty = np.empty((0, len(info.channels)))
        return Samples(self.source, info, gaze.end_s, empty, np.empty(0), ClockKind.DEVICE)

    def read(self, type_name: str, message: dict[str, Any]) -> Samples | None:
        """Return the samples of a message, None for those of other sensors; raise `PacketError`."""
        (info,) = self.signals
        try:
            if self._is_of_ros4hc:
                return ros4hc.samples_of(info, self.source, message)
            samples = samples_of(type_name, message)
        except ExchangeError as error:
            raise PacketError(str(error)) from error
        if self.settings.source not in (None, message["info"]["source"]):
            return None
        if samples.info.kind is not info.kind:  # another one on a topic of `OtherSignal`
            return None
        if samples.info.unit != info.unit or len(samples.info.channels) != len(info.channels):
            raise PacketError(
                f"a message has {len(samples.info.channels)} channels in {samples.info.unit or 'no unit'}; "
                f"the settings say {len(info.channels)} in {info.unit}"
            )
        times_s = samples.sample_times_s() if info.rate_hz is None else None
        start_s = samples.start_s
        stamp = message["header"]["stamp"]
        stamped_s = stamp["sec"] + stamp["nanosec"] * 1e-9
        if info.rate_hz is not None and abs(stamped_s - start_s) > 0.5 / info.rate_hz:
            # the header has the time of the newest sample: with it, a wrong rate shows at once
            start_s = stamped_s - (len(samples.values) - 1) / info.rate_hz
        return replace(
            samples, source=self.source, info=info, start_s=start_s, times_s=times_s, clock=ClockKind.DEVICE
        )

    def _open(self) -> tuple[list[tuple[Any, Read]], type[Exception]]:
        settings: RosTopicSettings = self.settings
        try:
            endpoints = TopicEndpoints(settings.domain)
        except OSError as error:
            raise LinkLost(str(error)) from error
        of_kind = ros4hc.type_of if self._is_of_ros4hc else type_of
        wanted: list[tuple[str, SignalKind, Read]] = [
            (settings.topic, settings.kind, partial(self.read, _type_name(settings.kind)))
        ]
        if settings.gaze_topic is not None:
            wanted.append((settings.gaze_topic, SignalKind.GAZE, self.read_gaze))
        readers = [
            (endpoints.reader(topic, of_kind(kind), depth=MAX_MESSAGES), read) for topic, kind, read in wanted
        ]
        return readers, endpoints.failure

    @property
    def _is_of_ros4hc(self) -> bool:
        return bool(self.settings.messages == ros4hc.PACKAGE)


def _type_name(kind: SignalKind) -> str:
    return f"{PACKAGE}/msg/{fields_of(kind)[0]}"
