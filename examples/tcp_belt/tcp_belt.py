"""A breathing belt that sends one number a line over TCP, 25 times a second."""

import asyncio
import math

import numpy as np

from handover_body.drivers.base import DriverSettings, LinkLost, PacketError, SensorDriver, now_s
from handover_body.model.signals import LinkState, Samples, SensorReport, SignalInfo, SignalKind

BREATH = SignalInfo(SignalKind.RESPIRATION, "C62", 25.0, ("belt",), -100, 100, method="belt")


class BeltSettings(DriverSettings):
    """Where the belt listens."""

    host: str = "127.0.0.1"
    port: int


class BeltDriver(SensorDriver):
    """One belt."""

    settings_model = BeltSettings
    signals = (BREATH,)

    async def run(self, sink):
        try:
            reader, writer = await asyncio.open_connection(self.settings.host, self.settings.port, limit=256)
            sink(SensorReport(self.source, now_s(), link=LinkState.CONNECTED))
            try:
                while line := await reader.readline():
                    try:
                        sink(Samples(self.source, BREATH, now_s(), np.array([[parse(line)]])))
                    except PacketError as error:
                        self.reject(sink, error)
            finally:
                writer.close()
        except (OSError, ValueError) as error:  # ValueError: a line without end
            raise LinkLost(f"the belt failed: {error}") from error
        raise LinkLost("the belt closed the connection")


def parse(line: bytes) -> float:
    """Return the number of a line; raise `PacketError`."""
    try:
        value = float(line)
    except ValueError:
        raise PacketError(f"{line[:20]!r} is no number") from None
    if not math.isfinite(value):
        raise PacketError("a number that is not finite")
    return value
