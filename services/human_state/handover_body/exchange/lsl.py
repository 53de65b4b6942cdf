"""Signals and features as streams of the Lab Streaming Layer, and streams as samples.

The description of a stream has the channels with unit and type, the pseudonym of the person, and the method.
Time stamps on the wire are those of the local clock of LSL.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from handover_body.formats.errors import ExchangeError
from handover_body.formats.extra import required
from handover_body.formats.lsl import CONTENT_TYPES, LslClock, signal_info
from handover_body.model.features import UNITS, Feature
from handover_body.model.signals import ClockKind, Samples

MAX_OUTLETS: Final = 256
MAX_BUFFERED_S: Final = 60
MAX_CHUNK_SAMPLES: Final = 4096


class LslOutlets:
    """One outlet for each signal and feature, made with the first value. Not thread-safe.

    `subject` is the pseudonym of the person: streams are visible to the whole local network, so nothing is
    published unless somebody makes this object.
    """

    def __init__(self, subject: str) -> None:
        self._lsl: Any = required("pylsl")
        self._subject = subject
        self._clock = LslClock()
        self._outlets: dict[str, Any] = {}

    def push(self, item: Samples | Feature) -> None:
        """Send samples, or a feature (value, quality, and 1 if it is valid). Texts are sent as texts.

        Raises `ExchangeError` beyond `MAX_OUTLETS`.
        """
        if isinstance(item, Samples):
            self._push_samples(item)
        else:
            self._push_feature(item)

    def has_consumers(self, name: str) -> bool:
        """Return whether somebody receives the stream `name`, such as `h10 ecg`."""
        outlet = self._outlets.get(name)
        return outlet is not None and bool(outlet.have_consumers())

    def close(self) -> None:
        """Close all streams."""
        self._outlets.clear()

    def _push_samples(self, item: Samples) -> None:
        info = item.info
        outlet = self._outlet(
            f"{item.source} {info.kind.value}",
            CONTENT_TYPES.get(info.kind, info.kind.value),
            [(label or info.kind.value, info.unit) for label in info.channels],
            rate_hz=info.rate_hz or 0.0,
            method=info.method,
        )
        stamps = [self._clock.to_lsl(at_s) for at_s in item.sample_times_s().tolist()]
        if stamps:
            outlet.push_chunk(item.values.tolist(), stamps)

    def _push_feature(self, item: Feature) -> None:
        name = f"{item.source} {item.name.value} feature"  # a signal may have the same name
        stamp = self._clock.to_lsl(item.at_s)
        if isinstance(item.value, str):
            outlet = self._outlet(name, "Markers", [(item.name.value, "")], is_text=True, method=item.method)
            outlet.push_sample([item.value], stamp)
            return
        channels = [(item.name.value, UNITS.get(item.name, "")), ("quality", ""), ("valid", "")]
        outlet = self._outlet(name, "Feature", channels, method=item.method)
        outlet.push_sample([item.value, item.quality, float(item.status == "valid")], stamp)

    def _outlet(
        self,
        name: str,
        kind: str,
        channels: Sequence[tuple[str, str]],
        *,
        rate_hz: float = 0.0,
        method: str = "",
        is_text: bool = False,
    ) -> Any:
        if name in self._outlets:
            return self._outlets[name]
        if len(self._outlets) >= MAX_OUTLETS:
            raise ExchangeError(
                f"there are {MAX_OUTLETS} streams; {name} is one too many, send fewer sensors"
            )
        lsl = self._lsl
        data = lsl.cf_string if is_text else lsl.cf_double64
        # With a source id a receiver finds the stream again after a restart.
        info = lsl.StreamInfo(name, kind, len(channels), rate_hz, data, f"handover {self._subject} {name}")
        described = info.desc()
        described.append_child_value("manufacturer", "Handover")
        described.append_child("subject").append_child_value("id", self._subject)
        described.append_child("acquisition").append_child_value("method", method)
        listed = described.append_child("channels")
        for label, unit in channels:
            channel = listed.append_child("channel")
            channel.append_child_value("label", label)
            channel.append_child_value("unit", unit)
            channel.append_child_value("type", kind)
        outlet = self._outlets[name] = lsl.StreamOutlet(info, max_buffered=MAX_BUFFERED_S)
        return outlet


class LslInlet:
    """Receives one numeric stream. `pull` never blocks; run it often enough for `MAX_BUFFERED_S`.

    Opening it waits for the description of the stream, at most `timeout_s`. Raises `ExchangeError`.
    """

    def __init__(self, info: Any, timeout_s: float = 10.0) -> None:
        lsl: Any = required("pylsl")
        self._clock = LslClock()
        self._inlet = lsl.StreamInlet(
            info, max_buflen=MAX_BUFFERED_S, processing_flags=lsl.proc_clocksync | lsl.proc_monotonize
        )
        try:
            described = self._inlet.info(timeout_s)
            self._inlet.open_stream(timeout_s)
        except (TimeoutError, RuntimeError, OSError) as error:
            raise ExchangeError(f'the stream "{info.name()}" does not answer: {error}') from None
        self.signal, self.subject = signal_info(described)
        self.source: str = described.source_id() or described.name()

    def pull(self) -> Samples | None:
        """Return what was received since the last call; None if that is nothing.

        The times are those of the sender's clock, mapped to ours by LSL.
        """
        rows, stamps = self._inlet.pull_chunk(timeout=0.0, max_samples=MAX_CHUNK_SAMPLES)
        if not stamps:
            return None
        times_s = np.array(stamps, np.float64) + self._clock.offset_s
        return Samples(
            self.source,
            self.signal,
            float(times_s[0]),
            np.array(rows, np.float64).reshape(len(stamps), -1),
            times_s,
            ClockKind.DEVICE,
        )

    def close(self) -> None:
        """End the reception."""
        self._inlet.close_stream()
