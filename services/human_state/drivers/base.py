"""What a sensor driver is: thirty lines that turn a device into `Samples`.

A driver is a class with `settings_model`, `discover` and `run`. A package registers it by an entry point, and
nothing else in the tree knows its name:

    [project.entry-points."handover.sensor_drivers"]
    my-belt = "my_belt:BeltDriver"

`run` serves one connection: it opens the device, passes samples and reports to the sink, raises `LinkLost`
when the device is gone. Reconnection with backoff, the mapping of the device's clock, gaps, jumps, rates and
saturation are the same for all drivers.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from pydantic import BaseModel, ConfigDict

from handover.extensions import ExtensionPoint
from services.human_state.model.signals import Samples, SensorReport, SignalInfo

Sink = Callable[[Samples | SensorReport], None]
"""Receives what a driver produces. It never blocks."""


class LinkLost(Exception):
    """The connection to the device ended; the text says why. The driver is run again after a pause."""


class DriverSettings(BaseModel):
    """The settings of every driver; a driver adds its own."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True, slots=True)
class FoundDevice:
    """A device that was discovered: its address, name, and signal strength in dBm where there is one."""

    address: str
    name: str
    rssi_dbm: int | None = None


class SensorDriver(ABC):
    """One sensor of a person or a place. Its methods run on the event loop of the service."""

    settings_model: ClassVar[type[DriverSettings]]

    def __init__(self, source: str, settings: Any) -> None:
        self.source: Final = source
        self.settings = settings

    @property
    @abstractmethod
    def signals(self) -> tuple[SignalInfo, ...]:
        """The signals that this device sends with these settings."""

    @abstractmethod
    async def run(self, sink: Sink) -> None:
        """Serve one connection until it is cancelled. Raise `LinkLost` when the device is gone."""

    @classmethod
    async def discover(cls, timeout_s: float) -> list[FoundDevice]:  # noqa: ARG003
        """Return the devices of this kind that answer within `timeout_s`; none if there is no search."""
        return []


SENSOR_DRIVERS: Final = ExtensionPoint("sensor driver", "handover.sensor_drivers", {})
