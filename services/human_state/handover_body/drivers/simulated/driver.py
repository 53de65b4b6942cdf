"""The simulated sensor: packets of the chosen signals at their pace, seeded, with faults on request.

With a `pace` of 1 the packets come in real time, stamped by a device clock with its own origin and drift;
with another pace, or 0 for as fast as possible, the times are those of a recording.
"""

import asyncio
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from handover.formats.strict_json import StrictModel
from handover.messages import message
from handover_body.drivers.base import DriverSettings, FoundDevice, LinkLost, SensorDriver, Sink, now_s
from handover_body.drivers.simulated.person import Posture, SimulatedPerson
from handover_body.drivers.simulated.waveforms import EVENTS, WAVES, Events, Wave
from handover_body.model.cardiovascular import Physiology
from handover_body.model.signals import ClockKind, LinkState, Samples, SensorReport, SignalInfo, SignalKind

EVENTS_SILENCE_S = 120.0
"""A sensor of nothing but events, such as blinks, may be silent for so long."""
STRAP = "chest strap"
"""How the method of a signal begins whose sensor measures its contact."""
FaultKind = Literal[
    "gap",
    "clockJump",
    "artefact",
    "strapOff",
    "silentStrapOff",
    "saturated",
    "flat",
    "reconnect",
    "rate",
    "unit",
]


class SimulatedFault(DriverSettings):
    """One fault: from `at_s` for `duration_s` of simulated time, of one signal or of all.

    `size` is the jump in s (`clockJump`), or the factor of the rate or of the values (`rate`, `unit`).
    `strapOff` is reported by the contact of the device, `silentStrapOff` is not: the electrodes are open.
    """

    kind: FaultKind
    at_s: Annotated[float, Field(ge=0)]
    duration_s: Annotated[float, Field(gt=0)] = 5.0
    size: float = 2.0
    signal: SignalKind | None = None

    def is_on(self, at_s: float, signal: SignalKind) -> bool:
        """Return whether the fault holds at this time of this signal."""
        return self.at_s <= at_s < self.at_s + self.duration_s and self.signal in (None, signal)


class EffortStep(DriverSettings):
    """From `at_s` on the person works with `effort`, 0 to 1, in a posture, breathing or not."""

    at_s: Annotated[float, Field(ge=0)]
    effort: Annotated[float, Field(ge=0, le=1)] = 0.0
    posture: Posture | None = None
    is_breathing: bool = True


class Acts(StrictModel, DriverSettings):
    """What a simulated person does from now on; what is absent stays as it is.

    `lean` is that of the upper body to the right and forwards, -1 to 1; `movement` what a radar sees, 0 to
    100. `contact` false takes the straps off. `walkingMps` is the speed of a walk, with its effort and gait.
    """

    effort: Annotated[float, Field(ge=0, le=1)] | None = None
    posture: Posture | None = None
    is_breathing: bool | None = Field(None, alias="isBreathing")
    lean: tuple[Annotated[float, Field(ge=-1, le=1)], Annotated[float, Field(ge=-1, le=1)]] | None = None
    movement: Annotated[float, Field(ge=0, le=100)] | None = None
    contact: bool | None = None
    walking_mps: Annotated[float, Field(ge=0, le=5)] | None = Field(None, alias="walkingMps")
    blinks_per_minute: Annotated[float, Field(ge=0, le=90)] | None = Field(None, alias="blinksPerMinute")


class SimulatedSettings(DriverSettings):
    """What is simulated."""

    signals: tuple[SignalKind, ...] = (SignalKind.ECG, SignalKind.HEART_RATE, SignalKind.ACCELERATION)
    rates_hz: dict[SignalKind, Annotated[float, Field(gt=0, le=4000)]] = Field(default_factory=dict)
    seed: int = Field(0, ge=0)
    rest_bpm: float = 65.0
    max_bpm: float = 185.0
    vo2_max: float = Field(35.0, ge=7, le=100)
    """The aerobic capacity in ml/kg/min: what a walk costs of it is the effort."""
    program: tuple[EffortStep, ...] = ()
    faults: tuple[SimulatedFault, ...] = ()
    packet_s: float = Field(0.25, gt=0, le=5)
    pace: float = Field(1.0, ge=0)
    """How many times faster than life; 0: as fast as possible."""
    duration_s: float | None = Field(None, gt=0)
    start_s: float | None = None
    """The time of the first sample, in s since 1970; None: now."""
    drift: float = Field(20e-6, ge=-200e-6, le=200e-6)
    """How much faster the clock of the device runs than ours."""
    battery: float = Field(0.9, ge=0, le=1)

    @model_validator(mode="after")
    def _signals_are_known(self) -> "SimulatedSettings":
        kinds = (*WAVES, *EVENTS)
        unknown = [kind for kind in self.signals if kind not in kinds]
        if unknown or not self.signals:
            raise ValueError(
                f"{', '.join(unknown) or 'no signal'} cannot be simulated; choose from {', '.join(kinds)}"
            )
        return self


class SimulatedDriver(SensorDriver):
    """A sensor on a `SimulatedPerson`, which may be shared: who gives one advances it by this driver only."""

    settings_model = SimulatedSettings

    def __init__(
        self, source: str, settings: SimulatedSettings, person: SimulatedPerson | None = None
    ) -> None:
        super().__init__(source, settings)
        self.person = person or SimulatedPerson(
            settings.seed, body=Physiology(settings.rest_bpm, settings.max_bpm, settings.vo2_max)
        )
        self._tracks = [
            _EventTrack(source, EVENTS[kind], settings, number)
            if kind in EVENTS
            else _Track(source, _with_rate(*WAVES[kind], settings), settings, number)
            for number, kind in enumerate(settings.signals, start=1)
        ]
        if EVENTS.keys() >= set(settings.signals):
            self.max_silence_s = EVENTS_SILENCE_S
        self._elapsed_s = 0.0
        self._began_s: float | None = None
        self._lost: set[SimulatedFault] = set()
        self._is_worn = True
        self.person.advance(0.0)

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        return tuple(track.info for track in self._tracks)

    @classmethod
    async def discover(cls, timeout_s: float) -> list[FoundDevice]:
        """Return the one simulated person."""
        return [FoundDevice("simulated", "Simulated person")]

    async def run(self, sink: Sink) -> None:
        settings: SimulatedSettings = self.settings
        sink(SensorReport(self.source, now_s(), link=LinkState.CONNECTED, battery=settings.battery))
        began = asyncio.get_running_loop().time() - self._elapsed_s / (settings.pace or 1.0)
        self._begin()
        while settings.duration_s is None or self._elapsed_s < settings.duration_s - 1e-9:
            due_s = self._elapsed_s + settings.packet_s
            due = began + due_s / settings.pace if settings.pace else 0.0
            await asyncio.sleep(max(0.0, due - asyncio.get_running_loop().time()) if settings.pace else 0.0)
            for samples in self.next_packets():
                sink(samples)
            self._lose_link()

    def next_packets(self) -> list[Samples]:
        """Return the packets of the next `packet_s` at once: for a loop with its own clock."""
        began_s = self._begin()
        self._elapsed_s += self.settings.packet_s
        self._advance()
        made = [track.until(self.person, self._elapsed_s, began_s) for track in self._tracks]
        return [self._worn(samples) for samples in made if samples is not None]

    def _worn(self, samples: Samples) -> Samples:
        is_off = not self._is_worn and samples.info.method.startswith(STRAP)
        return replace(samples, has_contact=False) if is_off else samples

    def _begin(self) -> float:
        """Return the time of the first sample in s since 1970."""
        if self._began_s is None:
            self._began_s = now_s() if self.settings.start_s is None else self.settings.start_s
        return self._began_s

    def simulate(self, changes: Any) -> None:
        acts, person = Acts.model_validate(changes), self.person
        if acts.contact is not None:
            self._is_worn = acts.contact
        if "walking_mps" in acts.model_fields_set:
            person.walk(acts.walking_mps or 0.0)
        if acts.blinks_per_minute is not None:
            person.eyes.blinks_per_minute = acts.blinks_per_minute
        done = {"contact", "walking_mps", "blinks_per_minute"}
        for name, value in acts.model_dump(exclude=done, exclude_none=True).items():
            setattr(person, name, value)

    def _advance(self) -> None:
        for step in self.settings.program:
            if self._elapsed_s - self.settings.packet_s <= step.at_s < self._elapsed_s:
                self.person.effort = step.effort
                self.person.is_breathing = step.is_breathing
                self.person.posture = step.posture or self.person.posture
        self.person.advance(self._elapsed_s - self.person.now_s)

    def _lose_link(self) -> None:
        for fault in self.settings.faults:
            if fault.kind == "reconnect" and fault.at_s <= self._elapsed_s and fault not in self._lost:
                self._lost.add(fault)
                self._elapsed_s += fault.duration_s
                self._advance()
                for track in self._tracks:
                    track.until(self.person, self._elapsed_s, 0.0)
                raise LinkLost(message("health.sensor.lost", "the connection was lost"))


class _Track:
    """The samples of one signal, with its faults."""

    def __init__(
        self, source: str, made: tuple[SignalInfo, Wave], settings: SimulatedSettings, number: int
    ) -> None:
        self.info, self._wave = made
        self._source = source
        self._settings = settings
        self._random = np.random.default_rng([settings.seed, number])
        self._sent = 0
        self._next_s = 0.0
        self._last: np.ndarray | None = None

    def until(self, person: SimulatedPerson, end_s: float, began_s: float) -> Samples | None:
        """Return the samples before `end_s` of simulated time; None when there are none or a gap."""
        faults = [fault for fault in self._settings.faults if fault.is_on(self._next_s, self.info.kind)]
        rate_hz = self.info.rate_hz or 1.0
        true_hz = rate_hz * math.prod(fault.size for fault in faults if fault.kind == "rate")
        count = math.ceil((end_s - self._next_s) * true_hz - 1e-9)
        if count <= 0:
            return None
        times_s = self._next_s + np.arange(count) / true_hz
        start_s, self._next_s = self._next_s, self._next_s + count / true_hz
        values = self._wave(person, times_s, self._random)
        values = _with_faults(values, self.info, faults, self._random, self._last)
        values = np.clip(values, self.info.min_value, self.info.max_value)
        self._last = values[-1]
        if any(fault.kind == "gap" for fault in faults):
            return None
        device_s = start_s + sum(
            fault.size
            for fault in self._settings.faults
            if fault.kind == "clockJump" and fault.at_s <= start_s and fault.signal in (None, self.info.kind)
        )
        samples = Samples(self._source, self.info, began_s + device_s, values, clock=ClockKind.RECORDING)
        if self._settings.pace == 1:
            origin_s = 1000.0  # any; a device counts from when it was switched on
            device_s = origin_s + device_s * (1 + self._settings.drift)
            samples = replace(samples, start_s=device_s, clock=ClockKind.DEVICE)
        return _with_contact(samples, faults)


class _EventTrack:
    """The events of one irregular signal, with its faults; there is no rate that could lie."""

    def __init__(
        self, source: str, made: tuple[SignalInfo, Events], settings: SimulatedSettings, number: int
    ) -> None:
        self.info, self._events = made
        self._source = source
        self._settings = settings
        self._random = np.random.default_rng([settings.seed, number])
        self._next_s = 0.0
        self._last: np.ndarray | None = None

    def until(self, person: SimulatedPerson, end_s: float, began_s: float) -> Samples | None:
        """Return what has ended before `end_s` of simulated time; None for nothing, and in a gap."""
        events = self._events(person, self._next_s, end_s)
        active = self._settings.faults
        faults = [fault for fault in active if fault.is_on(self._next_s, self.info.kind)]
        self._next_s = end_s
        if not events or any(fault.kind == "gap" for fault in faults):
            return None
        rows = np.array(events)
        values = _with_faults(rows[:, 1:], self.info, faults, self._random, self._last)
        self._last = values[-1]
        times_s = rows[:, 0] + sum(
            fault.size
            for fault in active
            if fault.kind == "clockJump" and fault.at_s <= end_s and fault.signal in (None, self.info.kind)
        )
        clock = ClockKind.RECORDING
        if self._settings.pace == 1:
            times_s, clock = 1000.0 + times_s * (1 + self._settings.drift), ClockKind.DEVICE
        else:
            times_s = times_s + began_s
        samples = Samples(self._source, self.info, float(times_s[0]), values, times_s, clock)
        return _with_contact(samples, faults)


def _with_faults(
    values: np.ndarray,
    info: SignalInfo,
    faults: Sequence[SimulatedFault],
    random: np.random.Generator,
    last: np.ndarray | None,
) -> np.ndarray:
    """Return the values that a faulty sensor sends; `last` is the row before them."""
    for fault in faults:
        if fault.kind == "artefact":
            spread = max(1.0, float(np.nanstd(values)) or float(np.nanmean(np.abs(values))))
            values = values + random.normal(0, 8 * spread, values.shape)
        elif fault.kind in {"strapOff", "silentStrapOff"}:
            values = np.zeros_like(values) if fault.kind == "silentStrapOff" else values * 0.01
        elif fault.kind == "saturated":
            values = np.full_like(values, info.max_value)
        elif fault.kind == "flat":
            values = np.tile(values[:1] if last is None else last, (len(values), 1))
        elif fault.kind == "unit":
            values = values * fault.size
    return values


def _with_contact(samples: Samples, faults: Sequence[SimulatedFault]) -> Samples:
    if any(fault.kind == "strapOff" for fault in faults):
        return replace(samples, has_contact=False)
    return replace(samples, has_contact=True if samples.info.method.startswith(STRAP) else None)


def _with_rate(info: SignalInfo, wave: Wave, settings: SimulatedSettings) -> tuple[SignalInfo, Wave]:
    return replace(info, rate_hz=settings.rates_hz.get(info.kind, info.rate_hz)), wave
