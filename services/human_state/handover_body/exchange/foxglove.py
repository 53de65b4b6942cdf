"""The Foxglove WebSocket protocol for live signals, and a layout for the Foxglove app.

The protocol is that of https://github.com/foxglove/ws-protocol, as far as a server needs it that only
sends: `serverInfo`, `advertise`, `subscribe`, `unsubscribe`, `status`, and messages with data. It is written
here since the server of the Foxglove SDK has a port of its own, without access control and without a check
of `Origin`.

Each item is a JSON message with the schema and topic of recordings. In addition each sample of a waveform is
a message on `/wave/SOURCE/KIND`, with the time at which it was taken, so that a plot shows it as it was.
"""

import json
import struct
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from secrets import token_hex
from typing import Any, Final

import orjson

from handover_body.formats.extra import required
from handover_body.formats.json_messages import SCHEMAS, Recorded, schema_name, time_of, to_json, topic_of
from handover_body.model.signals import Samples, SignalKind

SUBPROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""The names of the protocol, the newer one first. What is used of it is the same in both."""
LAYOUT: Final = Path(__file__).parent / "foxglove-layout.json"
"""To import in the Foxglove app; change the names of the sensors in it to yours."""
MAX_TOPICS: Final = 1024
MAX_WAITING: Final = 4096
"""Messages with data that wait to be sent; of more the oldest are dropped."""
MAX_WAVE_HZ: Final = 600.0
"""Waveforms above this rate are sent as packets only."""
_WAVE: Final = {
    "title": "handover.Wave",
    "type": "object",
    "properties": {"values": {"type": "array", "items": {"type": ["number", "null"]}}},
}
_DATA: Final = struct.Struct("<BIQ")
"""The head of a message with data: 1, the id of the subscription, the time in ns."""
_DATA_OPCODE: Final = 1
_ERROR_LEVEL: Final = 2
_MAX_ID: Final = 2**32 - 1


class FoxgloveStream:
    """What one client is sent, without a socket; not thread-safe.

    `publish` and `receive` add messages, and `take` returns those to send next. A topic is advertised with
    its first item after the client has connected. Data is made for subscriptions only.
    """

    def __init__(self) -> None:
        info = {"name": "Handover human state", "capabilities": [], "supportedEncodings": [], "metadata": {}}
        self._control: list[str] = [_text("serverInfo", **info, sessionId=token_hex(8))]
        self._data: deque[bytes] = deque(maxlen=MAX_WAITING)
        self._channels: dict[str, int] = {}
        self._subscriptions: dict[int, int] = {}
        """The channel of each subscription."""

    def publish(self, item: Recorded, subject: str) -> None:
        """Add an item of the person with the pseudonym `subject`."""
        name = schema_name(item)
        channel = self._channel(topic_of(item), {**SCHEMAS[name], "title": name})
        if self._has_reader(channel):
            self._add(channel, time_of(item), to_json(item, subject))
        if isinstance(item, Samples) and item.info.rate_hz and item.info.rate_hz <= MAX_WAVE_HZ:
            self._publish_wave(item)

    def receive(self, text: str) -> None:
        """Apply what the client has sent; what is not for a server that only sends is ignored."""
        try:
            message = orjson.loads(text)
            if message["op"] == "subscribe":
                self._subscribe(
                    {
                        int(subscription["id"]): int(subscription["channelId"])
                        for subscription in message["subscriptions"]
                    }
                )
            elif message["op"] == "unsubscribe":
                for number in message["subscriptionIds"]:
                    self._subscriptions.pop(int(number), None)
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            self._refuse(f"the message cannot be read: {error!r}"[:300])

    def take(self) -> list[str | bytes]:
        """Return what is to be sent, and forget it."""
        taken: list[str | bytes] = [*self._control, *self._data]
        self._control.clear()
        self._data.clear()
        return taken

    def drop_waiting(self) -> None:
        """Forget the data that waits: somebody it may be of has withdrawn the consent."""
        self._data.clear()

    def _subscribe(self, asked: Mapping[int, int]) -> None:
        topics = set(self._channels.values())
        for subscription, channel in asked.items():
            if channel not in topics or not 0 <= subscription <= _MAX_ID:
                self._refuse(f"there is no channel {channel} for the subscription {subscription}")
            elif len(self._subscriptions) < MAX_TOPICS or subscription in self._subscriptions:
                self._subscriptions[subscription] = channel
            else:
                self._refuse(f"a client has at most {MAX_TOPICS} subscriptions; end some of them")

    def _publish_wave(self, item: Samples) -> None:
        channel = self._channel(f"/wave/{item.source}/{item.info.kind.value}", _WAVE)
        if not self._has_reader(channel):
            return
        for at_s, row in zip(item.sample_times_s().tolist(), item.values.tolist(), strict=True):
            self._add(channel, at_s, {"values": row})

    def _channel(self, topic: str, schema: Mapping[str, Any]) -> int | None:
        """Return the channel of a topic, which is advertised if it is new; None beyond `MAX_TOPICS`."""
        number = self._channels.get(topic)
        if number is not None or len(self._channels) >= MAX_TOPICS:
            return number
        channel = self._channels[topic] = len(self._channels) + 1
        advertised = {
            "id": channel,
            "topic": topic,
            "encoding": "json",
            "schemaName": schema["title"],
            "schema": json.dumps(schema),
            "schemaEncoding": "jsonschema",
        }
        self._control.append(_text("advertise", channels=[advertised]))
        return channel

    def _has_reader(self, channel: int | None) -> bool:
        return channel in self._subscriptions.values()

    def _add(self, channel: int | None, at_s: float, content: Mapping[str, Any]) -> None:
        payload, at_ns = orjson.dumps(content), max(round(at_s * 1e9), 0)
        for subscription, of in self._subscriptions.items():
            if of == channel:
                self._data.append(_DATA.pack(_DATA_OPCODE, subscription, at_ns) + payload)

    def _refuse(self, reason: str) -> None:
        if len(self._control) < MAX_TOPICS:  # else the client does not read them
            self._control.append(_text("status", level=_ERROR_LEVEL, message=reason))


def _text(op: str, **members: Any) -> str:
    return json.dumps({"op": op, **members})


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
    is_plain = all(character.isalnum() or character in "_/-" for character in topic)
    return topic if is_plain else '"' + topic.replace("\\", "\\\\").replace('"', '\\"') + '"'
