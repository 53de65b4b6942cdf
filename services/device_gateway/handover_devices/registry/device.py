"""A registered device while the gateway runs: its description, its latest values and its connection."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from handover_datamodels.states import DeviceState
from handover_devices.model.description import Sensor
from handover_devices.protocol.messages import BadMessage, StateReport, Telemetry
from handover_devices.storage.device_store import StoredDevice

MIN_STALE_S: Final = 10.0
STALE_PERIODS: Final = 3.0
UNKNOWN_PERIOD_STALE_S: Final = 60.0
"""A value whose period is not known yet is stale after this time."""
MAX_FIRST_PERIOD_S: Final = 300.0
MAX_PERIOD_GROWTH: Final = 4.0
PERIOD_WEIGHT: Final = 0.2


class Link(Protocol):
    """How a device is connected; one adapter implements it for each transport."""

    boot: str
    """The run of the device's program."""

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message to the device."""

    def send_latest(self, message: Mapping[str, Any]) -> bool:
        """Send a message that must not wait; return False, without sending it, if it would."""

    def end(self, code: str, reason: str, *, retry: bool) -> None:
        """Send the reason and close the connection; `retry` says whether the device should connect again."""


@dataclass(slots=True)
class LatestValue:
    """The value with the latest time, and the one that was written to the broker last.

    `period_s` is the smoothed time between values, None before the second one since the gateway has started.
    """

    t: float
    value: float
    reported: float | None = None
    period_s: float | None = None

    def replace(self, t: float, value: float) -> None:
        """Replace the value by a later one. A pause of the device counts little in the period."""
        passed_s = t - self.t
        if passed_s > 0:
            known_s = self.period_s
            if known_s is None:
                self.period_s = min(passed_s, MAX_FIRST_PERIOD_S)
            else:
                passed_s = min(passed_s, MAX_PERIOD_GROWTH * known_s)
                self.period_s = known_s + PERIOD_WEIGHT * (passed_s - known_s)
        self.t, self.value = t, value

    def is_stale(self, now_s: float) -> bool:
        """Return whether newer values are missing: for three periods, at least `MIN_STALE_S`."""
        stale_s = UNKNOWN_PERIOD_STALE_S
        if self.period_s is not None:
            stale_s = max(MIN_STALE_S, STALE_PERIODS * self.period_s)
        return now_s - self.t > stale_s


@dataclass(slots=True)
class Device:
    """A device; times are seconds since 1970."""

    stored: StoredDevice
    values: Mapping[str, Sensor] = field(default_factory=dict)
    latest: dict[str, LatestValue] = field(default_factory=dict)
    state: DeviceState | None = None
    state_at: float = 0.0
    battery_level: float | None = None
    event: tuple[str, Any, float] | None = None
    link: Link | None = None
    linked_s: float = 0.0
    """When the connection began, by the monotonic clock."""
    drives: bool = False
    """Whether the connected program follows velocities."""
    seen_at: float | None = None
    has_news: bool = False
    """Whether something differs from what the broker has, beyond the dead bands."""

    def __post_init__(self) -> None:
        self.values = self.stored.description.values

    @property
    def name(self) -> str:
        """The name of the device."""
        return self.stored.name

    def describe(self, stored: StoredDevice) -> None:
        """Replace what is stored; values that the new description does not have are forgotten."""
        self.stored = stored
        self.values = stored.description.values
        self.latest = {name: latest for name, latest in self.latest.items() if name in self.values}
        self.has_news = True

    def require_known(self, message: Telemetry) -> list[str]:
        """Return the names of values outside their range; raise `BadMessage` for an unknown value."""
        outside: list[str] = []
        for name, value in message.values.items():
            sensor = self.values.get(name)
            if sensor is None:
                names = ", ".join(self.values) or "none"
                raise BadMessage(
                    "unknownValue",
                    f'{self.name} has no value "{name[:64]}"; it has {names[:500]}. Add a sensor to its '
                    "registration, or correct the name",
                    message.seq,
                )
            if (sensor.minimum is not None and value < sensor.minimum) or (
                sensor.maximum is not None and value > sensor.maximum
            ):
                outside.append(name)
        return outside

    def observe(self, message: Telemetry, t: float) -> None:
        """Keep the values of a message unless later ones are known."""
        for name, value in message.values.items():
            before = self.latest.get(name)
            if before is None:
                self.latest[name] = LatestValue(t, value)
                self.has_news = True
            elif t >= before.t:
                before.replace(t, value)
                if before.reported is None or abs(value - before.reported) > self.values[name].dead_band:
                    self.has_news = True

    def observe_state(self, message: StateReport, t: float) -> None:
        """Keep a state unless a later one is known."""
        if t >= self.state_at:
            self.has_news |= (message.state, message.battery_level) != (self.state, self.battery_level)
            self.state, self.state_at = message.state, t
            if message.battery_level is not None:
                self.battery_level = message.battery_level
