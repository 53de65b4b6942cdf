"""The Polar H10: ECG, acceleration, heart rate and intervals over one connection.

The strap closes the connection after some minutes on some hosts; the runner opens it again, and everything
is subscribed and started from the beginning. When the strap is taken off it still sends an ECG; the
intervals cease, and so contact is lost for all its signals.
"""

import asyncio
from typing import TYPE_CHECKING, ClassVar, Final, Literal

from handover_body.drivers.base import DriverSettings, LinkLost, PacketError, Sink, now_s
from handover_body.drivers.bluetooth import BluetoothDriver, BluetoothSettings
from handover_body.drivers.heart_rate_strap.driver import (
    HEART_RATE,
    HEART_RATE_MEASUREMENT,
    HEART_RATE_SERVICE,
    INTERVALS,
    BeatSamples,
)
from handover_body.drivers.heart_rate_strap.protocol import parse as parse_heart_rate
from handover_body.drivers.polar_h10.protocol import (
    ECG_RATE_HZ,
    GRAVITY,
    PMD_CONTROL,
    PMD_DATA,
    Measurement,
    check_answer,
    parse,
    start_command,
)
from handover_body.model.signals import ClockKind, Samples, SignalInfo, SignalKind

if TYPE_CHECKING:
    from bleak import BleakClient

ECG: Final = SignalInfo(
    SignalKind.ECG, "D82", ECG_RATE_HZ, ("",), -20_000, 20_000, 1.0, "chest strap, one lead"
)
ANSWER_S: Final = 5.0


class PolarH10Settings(BluetoothSettings):
    """What the H10 measures besides the heart rate."""

    ecg: bool = True
    acceleration_hz: Literal[25, 50, 100, 200] | None = 50
    range_g: Literal[2, 4, 8] = 8


class PolarH10Driver(BluetoothDriver):
    """One H10."""

    settings_model: ClassVar[type[DriverSettings]] = PolarH10Settings
    service_uuid = HEART_RATE_SERVICE
    name_prefixes = ("Polar H10",)
    silence_limits_s = {SignalKind.HEART_RATE: 2.5}  # noqa: RUF012 - overrides a ClassVar

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        settings: PolarH10Settings = self.settings
        wanted = [HEART_RATE, INTERVALS]
        if settings.ecg:
            wanted.append(ECG)
        if settings.acceleration_hz is not None:
            wanted.append(self._acceleration)
        return tuple(wanted)

    @property
    def _acceleration(self) -> SignalInfo:
        settings: PolarH10Settings = self.settings
        bound = settings.range_g * GRAVITY
        rate_hz = float(settings.acceleration_hz or 50)
        axes = ("x", "y", "z")
        return SignalInfo(
            SignalKind.ACCELERATION, "MSK", rate_hz, axes, -bound, bound, GRAVITY / 1000, "chest"
        )

    async def serve(self, client: "BleakClient", sink: Sink) -> None:
        beats = BeatSamples(self.source)
        contact: list[bool | None] = [None]
        answers: asyncio.Queue[bytes] = asyncio.Queue()

        def take_heart_rate(data: bytes) -> None:
            for samples in beats.of(parse_heart_rate(data), now_s()):
                contact[0] = samples.has_contact
                sink(samples)

        def take_data(data: bytes) -> None:
            frame = parse(data)
            info = ECG if frame.measurement is Measurement.ECG else self._acceleration
            if info not in self.signals:
                return
            start_s = frame.end_s - (len(frame.values) - 1) / (info.rate_hz or 1.0)
            is_worn = contact[0] if frame.measurement is Measurement.ECG else None
            sink(
                Samples(self.source, info, start_s, frame.values, clock=ClockKind.DEVICE, has_contact=is_worn)
            )

        await self.subscribe(client, HEART_RATE_MEASUREMENT, take_heart_rate, sink)
        await self.subscribe(client, PMD_CONTROL, answers.put_nowait, sink)
        await self.subscribe(client, PMD_DATA, take_data, sink)
        settings: PolarH10Settings = self.settings
        if settings.ecg:
            await _start(client, answers, Measurement.ECG, start_command(Measurement.ECG))
        if settings.acceleration_hz is not None:
            command = start_command(Measurement.ACCELERATION, settings.acceleration_hz, settings.range_g)
            await _start(client, answers, Measurement.ACCELERATION, command)


async def _start(
    client: "BleakClient", answers: "asyncio.Queue[bytes]", measurement: Measurement, command: bytes
) -> None:
    """Start a measurement and wait for its answer; one that is refused ends the connection."""
    await client.write_gatt_char(PMD_CONTROL, command, response=True)
    try:
        async with asyncio.timeout(ANSWER_S):
            while (answer := await answers.get())[1:3] != bytes([2, measurement]):
                pass
        check_answer(answer, measurement)
    except TimeoutError:
        raise LinkLost(f"the H10 did not answer to the start of {measurement.name.lower()}") from None
    except PacketError as error:
        raise LinkLost(str(error)) from error
