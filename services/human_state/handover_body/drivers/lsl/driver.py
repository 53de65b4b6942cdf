"""Any LSL stream of numbers: found by name, type or source id, pulled in chunks, with its clock corrected.

LSL maps the clocks of machines itself (`time_correction`); the rest, from the clock of LSL here to the time
since 1970, is one offset. Streams that were lost are searched again; a stamp that jumps is found by the
runner as of any device.
"""

import asyncio
import importlib
import math
from typing import Any, ClassVar, Final

import numpy as np
from pydantic import Field, model_validator

from handover.distribution import install_command
from handover.errors import UsageError
from handover_body.drivers.base import DriverSettings, FoundDevice, LinkLost, SensorDriver, Sink, now_s
from handover_body.model.signals import ClockKind, LinkState, Samples, SensorReport, SignalInfo, SignalKind

PULL_S: Final = 0.05
MAX_SAMPLES: Final = 4096
CORRECTION_PERIOD_S: Final = 10.0
MAX_CHANNELS: Final = 512


class LslSettings(DriverSettings):
    """Which stream, and what it measures. The stream says its rate and channels; the unit is given here."""

    kind: SignalKind
    unit: str
    rate_hz: float | None = Field(gt=0, le=100_000)
    """The nominal rate; null for irregular streams."""
    channels: tuple[str, ...] = Field(("",), max_length=MAX_CHANNELS)
    name: str | None = None
    type: str | None = None
    source_id: str | None = None
    scale: float = 1.0
    """What values are multiplied with: 1e6 for an ECG in volts and the unit microvolt."""
    search_s: float = Field(5.0, gt=0, le=60)

    @model_validator(mode="after")
    def _names_a_stream(self) -> "LslSettings":
        if not (self.name or self.type or self.source_id):
            raise ValueError("an LSL stream needs `name`, `type` or `source_id` to be found")
        return self


class LslDriver(SensorDriver):
    """One stream."""

    settings_model: ClassVar[type[DriverSettings]] = LslSettings
    max_latency_s = 0.05

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        settings: LslSettings = self.settings
        method = f"LSL {settings.name or settings.type or settings.source_id}"
        return (SignalInfo(settings.kind, settings.unit, settings.rate_hz, settings.channels, method=method),)

    async def run(self, sink: Sink) -> None:
        lsl = _pylsl()
        lost = _lost_errors(lsl)
        try:
            inlet = await asyncio.to_thread(self._open, lsl)
        except lost as error:
            raise LinkLost(f"the LSL stream cannot be opened: {_reason(error)}") from error
        sink(SensorReport(self.source, now_s(), link=LinkState.CONNECTED))
        (info,) = self.signals
        try:
            corrected_at, correction_s = -math.inf, 0.0
            while True:
                if (clock_s := lsl.local_clock()) - corrected_at >= CORRECTION_PERIOD_S:
                    correction_s = await asyncio.to_thread(inlet.time_correction, 2.0)
                    corrected_at = clock_s
                values, stamps = inlet.pull_chunk(timeout=0.0, max_samples=MAX_SAMPLES)
                if stamps:
                    sink(self._samples(info, values, np.asarray(stamps) + correction_s))
                await asyncio.sleep(PULL_S)
        except lost as error:
            raise LinkLost(f"the LSL stream was lost: {_reason(error)}") from error
        finally:
            await asyncio.to_thread(inlet.close_stream)

    def _samples(self, info: SignalInfo, values: Any, stamps_s: np.ndarray) -> Samples:
        array = np.asarray(values, dtype=np.float64).reshape(len(stamps_s), -1) * self.settings.scale
        if info.rate_hz is None:
            return Samples(self.source, info, float(stamps_s[0]), array, stamps_s, ClockKind.DEVICE)
        # by the newest stamp: a wrong rate then shows at once
        start_s = float(stamps_s[-1]) - (len(stamps_s) - 1) / info.rate_hz
        return Samples(self.source, info, start_s, array, clock=ClockKind.DEVICE)

    def _open(self, lsl: Any) -> Any:
        settings: LslSettings = self.settings
        wanted = {
            key: value
            for key, value in (
                ("name", settings.name),
                ("type", settings.type),
                ("source_id", settings.source_id),
            )
            if value is not None
        }
        (key, value), *others = wanted.items()
        streams = [
            stream
            for stream in lsl.resolve_byprop(key, value, timeout=settings.search_s)
            if all(getattr(stream, other)() == text for other, text in others)
        ]
        if not streams:
            raise LinkLost(
                f"no LSL stream with {wanted} within {settings.search_s:g} s; is it on this network?"
            )
        stream = streams[0]
        if stream.channel_format() == lsl.cf_string:
            raise UsageError(f"the LSL stream {stream.name()} has texts; choose one with numbers")
        if stream.channel_count() != len(settings.channels):
            raise UsageError(
                f"the LSL stream {stream.name()} has {stream.channel_count()} channels; name as many in "
                f"`channels`, not {len(settings.channels)}"
            )
        inlet = lsl.StreamInlet(stream, max_buflen=10, recover=False)
        inlet.open_stream(timeout=settings.search_s)
        return inlet

    @classmethod
    async def discover(cls, timeout_s: float) -> list[FoundDevice]:
        lsl = _pylsl()
        streams = await asyncio.to_thread(lsl.resolve_streams, timeout_s)
        return [
            FoundDevice(stream.source_id() or stream.uid(), f"{stream.name()} ({stream.type()})")
            for stream in streams
        ]


def _lost_errors(lsl: Any) -> tuple[type[Exception], ...]:
    """Return what pylsl raises for a stream that has ended; from 1.18 on, its package does not export it."""
    module = lsl if hasattr(lsl, "LostError") else importlib.import_module("pylsl.util")
    return module.LostError, module.TimeoutError


def _reason(error: Exception) -> str:
    return str(error) or "its outlet has ended, or does not answer"


def _pylsl() -> Any:
    try:
        import pylsl  # type: ignore[import-untyped]  # noqa: PLC0415 - of the extra
    except (ImportError, RuntimeError) as error:
        raise UsageError(f"LSL streams need the extra: {install_command('body')} ({error})") from error
    return pylsl
