"""A live stream for Foxglove over WebSocket, and its layout.

Each item is a JSON message with the schema and topic of recordings. In addition each sample of a waveform is
a message on `/wave/SOURCE/KIND`, with the time at which it was taken, so that a plot shows it as it was.
"""

import json
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from services.human_state.formats.errors import ExchangeError
from services.human_state.formats.extra import required
from services.human_state.formats.json_messages import (
    SCHEMAS,
    Recorded,
    schema_name,
    time_of,
    to_json,
    topic_of,
)
from services.human_state.model.signals import Samples, SignalKind

LAYOUT: Final = Path(__file__).parent / "foxglove-layout.json"
"""To import in the Foxglove app; change the names of the sensors in it to yours."""
MAX_TOPICS: Final = 1024
MAX_WAVE_HZ: Final = 600.0
"""Waveforms above this rate are sent as packets only."""
_WAVE: Final = {
    "title": "handover.Wave",
    "type": "object",
    "properties": {"values": {"type": "array", "items": {"type": ["number", "null"]}}},
}


class FoxgloveServer:
    """A WebSocket server for the Foxglove app. It listens on `host` and `port`; port 0 takes a free one.

    It has no access control of its own: on another address than loopback it needs `certificate` and `key`
    (PEM), and a network that only engineers reach. Not thread-safe.
    """

    def __init__(
        self,
        subject: str = "",
        host: str = "127.0.0.1",
        port: int = 0,
        certificate: bytes | None = None,
        key: bytes | None = None,
    ) -> None:
        if host not in {"127.0.0.1", "::1", "localhost"} and (certificate is None or key is None):
            raise ExchangeError(
                f"health data leaves the machine on {host}; give a certificate and its key, or use 127.0.0.1"
            )
        self._foxglove: Any = required("foxglove")
        self._context = self._foxglove.Context()
        self._subject = subject
        self._channels: dict[str, Any] = {}
        try:
            self._server = self._foxglove.start_server(
                name="Handover human state",
                host=host,
                port=port,
                context=self._context,
                tls_cert=certificate,
                tls_key=key,
            )
        except (RuntimeError, OSError, ValueError) as error:
            raise ExchangeError(f"the Foxglove server cannot listen on {host}:{port}: {error}") from None

    @property
    def port(self) -> int:
        """Return the port on which it listens."""
        return int(self._server.port)

    def publish(self, item: Recorded, subject: str | None = None) -> None:
        """Send an item to all clients; nothing waits for them. Raises `ExchangeError` beyond `MAX_TOPICS`."""
        channel = self._channel(topic_of(item), SCHEMAS[schema_name(item)], schema_name(item))
        content = to_json(item, self._subject if subject is None else subject)
        channel.log(content, log_time=round(time_of(item) * 1e9))
        if isinstance(item, Samples) and item.info.rate_hz and item.info.rate_hz <= MAX_WAVE_HZ:
            self._publish_wave(item)

    def close(self) -> None:
        """Close all connections."""
        for channel in self._channels.values():
            channel.close()
        self._server.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _publish_wave(self, item: Samples) -> None:
        wave = self._channel(f"/wave/{item.source}/{item.info.kind.value}", _WAVE, "handover.Wave")
        for at_s, row in zip(item.sample_times_s().tolist(), item.values.tolist(), strict=True):
            values = [value if value == value else None for value in row]  # noqa: PLR0124 - NaN
            wave.log({"values": values}, log_time=round(at_s * 1e9))

    def _channel(self, topic: str, schema: dict[str, Any], name: str) -> Any:
        if topic not in self._channels:
            if len(self._channels) >= MAX_TOPICS:
                raise ExchangeError(f"{topic} is one topic beyond {MAX_TOPICS}; send fewer sensors")
            self._channels[topic] = self._foxglove.Channel(
                topic, schema={**schema, "title": name}, message_encoding="json", context=self._context
            )
        return self._channels[topic]


def layout(
    waves: list[tuple[str, SignalKind]], rates: list[tuple[str, str]], mats: list[str], adl_source: str
) -> str:
    """Return a layout for the Foxglove app as JSON text.

    `waves` are source and kind of the waveforms, `rates` source and name of the features to plot, `mats` the
    sources of pressure maps, and `adl_source` that of activity and sleep position.
    """
    panels: Any = required("foxglove.layouts")

    def split(direction: str, contents: list[Any]) -> Any:
        items = [panels.SplitItem(content=content) for content in contents]
        return panels.SplitContainer(direction=direction, items=items)

    def plot(title: str, paths: list[tuple[str, str]]) -> Any:
        series = [panels.PlotSeries(value=path, label=label, enabled=True) for label, path in paths]
        return panels.PlotPanel(
            title=title, config=panels.PlotConfig(paths=series, following_view_width=20.0)
        )

    plots = [
        plot(f"{kind.value} ({source})", [(kind.value, f"{_path('/wave', source, kind.value)}.values[0]")])
        for source, kind in waves
    ]
    values = plot(
        "Values",
        [(f"{name} ({source})", f"{_path('/feature', name, source)}.value") for source, name in rates],
    )
    quality = plot(
        "Quality",
        [(f"{name} ({source})", f"{_path('/feature', name, source)}.quality") for source, name in rates],
    )
    states = panels.StateTransitionsPanel(
        title="Activity and sleep position",
        config=panels.StateTransitionsConfig(
            paths=[
                panels.StateTransitionsSeries(
                    value=f"{_path('/feature', name, adl_source)}.value", label=name
                )
                for name in ("activity", "sleepPosition")
            ]
        ),
    )
    raw = [
        panels.RawMessagesPanel(
            title=f"Pressure ({mat})",
            config=panels.RawMessagesConfig(topic_path=f"{_path('/signal', mat, 'pressureMap')}.values"),
        )
        for mat in mats
    ]
    content = split("row", [split("column", [*plots, values]), split("column", [quality, states, *raw])])
    return str(panels.Layout(content=content).to_json())


def shipped_layout() -> str:
    """Return the text of the file `LAYOUT`: a strap, a radar, a mat and an IMU, named as in the manual."""
    waves = [("polar-h10-1", SignalKind.ECG), ("radar-1", SignalKind.RESPIRATION)]
    names = ("heartRate", "hrvRmssd", "exertionLevel")
    rates = [
        *(("polar-h10-1", name) for name in names),
        ("radar-1", "heartRate"),
        ("radar-1", "breathingRate"),
    ]
    text = layout([*waves, ("imu-1", SignalKind.ACCELERATION)], rates, ["mat-1"], "imu-1")
    return json.dumps(json.loads(text), indent=2) + "\n"


def _path(*parts: str) -> str:
    """Return a topic as a message path; Foxglove wants quotes where a name has other characters."""
    topic = "/".join(parts)
    is_plain = all(one.isalnum() or one in "_/-" for one in topic)
    return topic if is_plain else '"' + topic.replace("\\", "\\\\").replace('"', '\\"') + '"'
