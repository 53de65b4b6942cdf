"""One ROS 2 topic of `handover_human_msgs`, read from DDS directly.

Services do not depend on the bridge, and the broker has no waveforms; so the driver joins the ROS domain by
itself. Times are those of the publisher: they count as a device clock, mapped to ours.
"""

import asyncio
from dataclasses import replace
from typing import Any, ClassVar, Final

from pydantic import Field

from handover.ros_dds import MAX_DOMAIN, TopicEndpoints
from services.human_state.drivers.base import DriverSettings, LinkLost, PacketError, SensorDriver, Sink, now_s
from services.human_state.drivers.ros_topic.messages import PACKAGE, as_message, fields_of, type_of
from services.human_state.formats.errors import ExchangeError
from services.human_state.formats.ros import samples_of
from services.human_state.model.signals import (
    ClockKind,
    LinkState,
    Samples,
    SensorReport,
    SignalInfo,
    SignalKind,
)

PULL_S: Final = 0.02
MAX_MESSAGES: Final = 256


class RosTopicSettings(DriverSettings):
    """The topic, and the signal that its messages must carry. `source` accepts one sensor of several."""

    topic: str = Field(pattern=r"^/?[A-Za-z_][A-Za-z0-9_/]*$", max_length=200)
    kind: SignalKind
    unit: str
    rate_hz: float | None = Field(None, gt=0, le=100_000)
    channels: tuple[str, ...] = ("",)
    domain: int = Field(0, ge=0, le=MAX_DOMAIN)
    source: str | None = None


class RosTopicDriver(SensorDriver):
    """One topic."""

    settings_model: ClassVar[type[DriverSettings]] = RosTopicSettings
    max_latency_s = 0.1
    stamps_oldest = True

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        one: RosTopicSettings = self.settings
        return (SignalInfo(one.kind, one.unit, one.rate_hz, one.channels, method=f"ROS {one.topic}"),)

    async def run(self, sink: Sink) -> None:
        settings: RosTopicSettings = self.settings
        reader, failure = await asyncio.to_thread(self._open)
        sink(SensorReport(self.source, now_s(), link=LinkState.CONNECTED))
        type_name = f"{PACKAGE}/msg/{fields_of(settings.kind)[0]}"
        while True:
            try:
                received = reader.take(N=MAX_MESSAGES)
            except failure as error:
                raise LinkLost(f"DDS failed: {error}") from error
            for sample in received:
                if type(sample).__name__ == "InvalidSample":
                    continue  # a publisher that left
                try:
                    samples = self.read(type_name, as_message(sample))
                except PacketError as error:
                    self.reject(sink, error)
                    continue
                if samples is not None:
                    sink(samples)
            await asyncio.sleep(PULL_S)

    def read(self, type_name: str, message: dict[str, Any]) -> Samples | None:
        """Return the samples of a message, None for those of other sensors; raise `PacketError`."""
        (info,) = self.signals
        try:
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

    def _open(self) -> tuple[Any, type[Exception]]:
        settings: RosTopicSettings = self.settings
        try:
            endpoints = TopicEndpoints(settings.domain)
        except OSError as error:
            raise LinkLost(str(error)) from error
        reader = endpoints.reader(settings.topic, type_of(settings.kind), depth=MAX_MESSAGES)
        return reader, endpoints.failure
