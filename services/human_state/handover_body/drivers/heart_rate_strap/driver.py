"""Heart rate and intervals between beats of any strap. A heart rate without intervals is kept."""

from typing import TYPE_CHECKING, Final

import numpy as np

from handover_body.drivers.base import Sink, now_s
from handover_body.drivers.beats import BeatClock, ContactWatch
from handover_body.drivers.bluetooth import BluetoothDriver
from handover_body.drivers.heart_rate_strap.protocol import HeartRateMeasurement, parse
from handover_body.model.signals import ClockKind, Samples, SignalInfo, SignalKind

if TYPE_CHECKING:
    from bleak import BleakClient

HEART_RATE_SERVICE: Final = "0000180d-0000-1000-8000-00805f9b34fb"
HEART_RATE_MEASUREMENT: Final = "00002a37-0000-1000-8000-00805f9b34fb"
HEART_RATE: Final = SignalInfo(
    SignalKind.HEART_RATE, "BPM", None, ("",), 0, 65_535, 1.0, "heart rate service"
)
INTERVALS: Final = SignalInfo(
    SignalKind.INTER_BEAT_INTERVAL, "C26", None, ("",), 0, 64_000, 1000 / 1024, "heart rate service"
)
DELAY_S: Final = 1.0
"""Straps notify once a second: so late a value may be."""


class BeatSamples:
    """Turns measurements into samples; the contact as the strap reports it, or from beats that cease."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._clock = BeatClock()
        self._contact = ContactWatch()

    def of(self, measured: HeartRateMeasurement, at_s: float) -> list[Samples]:
        """Return the samples of a notification that arrived at `at_s`."""
        has_beats = bool(measured.intervals_s)
        contact = self._contact.update(reported=measured.has_contact, has_beats=has_beats, at_s=at_s)
        made = [self._samples(HEART_RATE, [at_s], [measured.heart_rate_bpm], contact)]
        if has_beats:
            times_s = self._clock.times(list(measured.intervals_s), at_s)
            made.append(
                self._samples(
                    INTERVALS, times_s, [1000 * length_s for length_s in measured.intervals_s], contact
                )
            )
        return made

    def _samples(
        self, info: SignalInfo, times_s: list[float], values: list[float], contact: bool | None
    ) -> Samples:
        return Samples(
            self._source,
            info,
            times_s[0],
            np.array(values, dtype=np.float64)[:, None],
            np.array(times_s),
            ClockKind.ARRIVAL,
            DELAY_S,
            has_contact=contact,
        )


class HeartRateStrapDriver(BluetoothDriver):
    """Any device with the heart rate service."""

    service_uuid = HEART_RATE_SERVICE
    silence_limits_s = {SignalKind.HEART_RATE: 2.5}  # noqa: RUF012 - overrides a ClassVar

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        return (HEART_RATE, INTERVALS)

    async def serve(self, client: "BleakClient", sink: Sink) -> None:
        beats = BeatSamples(self.source)

        def take(data: bytes) -> None:
            for samples in beats.of(parse(data), now_s()):
                sink(samples)

        await self.subscribe(client, HEART_RATE_MEASUREMENT, take, sink)
