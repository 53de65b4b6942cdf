"""What a sensor driver is: thirty lines that turn a device into `Samples`.

A driver is a class with `settings_model`, `discover` and `run`. A package registers it by an entry point, and
nothing else in the tree knows its name:

    [project.entry-points."handover.sensor_drivers"]
    my-belt = "my_belt:BeltDriver"

`run` serves one connection: it opens the device, passes samples and reports to the sink, raises `LinkLost`
when the device is gone, and returns when there will never be more samples (the end of a recording).
Reconnection with backoff, the mapping of the device's clock, gaps, jumps, rates and saturation are the same
for all drivers: `runner.SensorRunner` does them.

A driver passes times as it knows them. Samples with `ClockKind.DEVICE` have `start_s` (or `times_s`) on the
clock of the device, in s since any origin; the runner maps them. With `ClockKind.ARRIVAL`, the times follow
from `now_s()` when the packet was received: its last sample is as old as the device says, or 0 s.
With `ClockKind.RECORDING` the times are kept.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from pydantic import BaseModel, ConfigDict, SecretStr

from handover.extensions import ExtensionPoint
from handover.messages import message
from handover_body.model.signals import Samples, SensorFault, SensorReport, SignalInfo, SignalKind

Sink = Callable[[Samples | SensorReport], None]
"""Receives what a driver produces. It never blocks."""


class LinkLost(Exception):
    """The connection to the device ended; the text says why. The driver is run again after a pause."""


HIDDEN: Final = "**********"
"""What people see in place of a secret, as pydantic writes it."""


class NotSimulated(Exception):
    """A sensor that measures cannot be given what its person does."""


class PacketError(Exception):
    """The bytes of a device are not what its protocol says; the only error that a parser raises."""


class DriverSettings(BaseModel):
    """The settings of every driver; a driver adds its own."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def shown(cls, stored: Mapping[str, Any]) -> dict[str, Any]:
        """Return stored settings for people: secrets (`SecretStr`) are `HIDDEN`."""
        return {name: HIDDEN if name in cls._secrets() and value else value for name, value in stored.items()}

    @classmethod
    def completed(cls, settings: Mapping[str, Any], stored: Mapping[str, Any]) -> dict[str, Any]:
        """Return given settings, in which a secret that is `HIDDEN` stays as it is stored."""
        return {
            name: stored[name] if value == HIDDEN and name in cls._secrets() and name in stored else value
            for name, value in settings.items()
        }

    @classmethod
    def _secrets(cls) -> frozenset[str]:
        return frozenset(name for name, field in cls.model_fields.items() if field.annotation is SecretStr)


@dataclass(frozen=True, slots=True)
class FoundDevice:
    """A device that was discovered: its address, name, and signal strength in dBm where there is one."""

    address: str
    name: str
    rssi_dbm: int | None = None


class SensorDriver(ABC):
    """One sensor of a person or a place. Its methods run on the event loop of the service."""

    settings_model: ClassVar[type[DriverSettings]]
    max_latency_s: ClassVar[float] = 0.1
    """At least one packet in 30 s is this fast: the uncertainty of a mapped device clock."""
    silence_limits_s: ClassVar[Mapping[SignalKind, float]] = {}
    """How long a signal may send nothing, where the default of the runner does not fit."""
    stamps_oldest: ClassVar[bool] = False
    """Whether the device may say only when a packet began. `start_s` is best computed from the newest sample
    and the rate: a wrong rate then shows in the first packet."""
    max_silence_s: float = 10.0
    """A connection that is silent for this long is closed and opened again."""

    def __init__(self, source: str, settings: Any) -> None:
        self.source: Final = source
        self.settings = settings
        self._rejected_s = 0.0

    @property
    @abstractmethod
    def signals(self) -> tuple[SignalInfo, ...]:
        """The signals that this device sends with these settings."""

    @property
    def left_out(self) -> Mapping[str, str]:
        """What the device or file has and these signals lack, with the reason by its name."""
        return {}

    @abstractmethod
    async def run(self, sink: Sink) -> None:
        """Serve one connection until it is cancelled. Raise `LinkLost` when the device is gone."""

    def simulate(self, changes: Any) -> None:  # noqa: ARG002 - for drivers that simulate
        """Take what a simulated person does now. Raises `NotSimulated`, or `ValueError` for bad values."""
        raise NotSimulated(f"{self.source} measures a person; only a simulated sensor can be given acts")

    def reject(self, sink: Sink, error: PacketError) -> None:
        """Report a packet that was dropped, at most once a second: a hostile device must not flood."""
        at_s = now_s()
        if abs(at_s - self._rejected_s) >= 1.0:
            self._rejected_s = at_s
            text = message("health.sensor.packet", "a packet was dropped: {error}", error=str(error)[:300])
            sink(SensorReport(self.source, at_s, fault=SensorFault.ARTEFACT, text=text))

    @classmethod
    async def discover(cls, timeout_s: float) -> list[FoundDevice]:
        """Return the devices of this kind that answer within `timeout_s`; none if there is no search."""
        return []


def now_s() -> float:
    """Return the time of arrival in s since 1970."""
    return time.time()


_DRIVERS: Final = "handover_body.drivers"
SENSOR_DRIVERS: Final = ExtensionPoint(
    "sensor driver",
    "handover.sensor_drivers",
    {
        "simulated": f"{_DRIVERS}.simulated.driver:SimulatedDriver",
        "recording": f"{_DRIVERS}.recording.driver:RecordingDriver",
        "heart-rate-strap": f"{_DRIVERS}.heart_rate_strap.driver:HeartRateStrapDriver",
        "polar-h10": f"{_DRIVERS}.polar_h10.driver:PolarH10Driver",
        "sensomative": f"{_DRIVERS}.sensomative.driver:SensomativeDriver",
        "corsano": f"{_DRIVERS}.corsano.driver:CorsanoDriver",
        "metamotion": f"{_DRIVERS}.metamotion.driver:MetaMotionDriver",
        "seeed-radar": f"{_DRIVERS}.seeed_radar.driver:RadarDriver",
        "max30100": f"{_DRIVERS}.max30100.driver:Max30100Driver",
        "lsl": f"{_DRIVERS}.lsl.driver:LslDriver",
        "brainflow": f"{_DRIVERS}.brainflow.driver:BrainFlowDriver",
        "vivalink": f"{_DRIVERS}.vivalink.driver:VivalinkDriver",
        "ros-topic": f"{_DRIVERS}.ros_topic.driver:RosTopicDriver",
    },
)
