"""Where an MQTT notification goes: server, topic, version and quality of service (clause 7.2)."""

from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import unquote, urlsplit

from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import shown

MQTT_SCHEMES: Final = ("mqtt://", "mqtts://")
MAX_TOPIC_LENGTH: Final = 65_535
"""The maximum of MQTT."""
_VERSIONS: Final = {"mqtt3.1.1": "3.1.1", "mqtt5.0": "5.0"}
_QUALITIES: Final = {"0": 0, "1": 1, "2": 2}


@dataclass(frozen=True, slots=True)
class MqttAddress:
    """An MQTT server, the client's identity, and the topic of the notifications."""

    host: str
    port: int
    tls: bool
    username: str | None
    password: str | None
    topic: str
    version: str = "5.0"
    qos: int = 0

    @property
    def connection(self) -> tuple[Any, ...]:
        """What identifies the connection."""
        return (self.host, self.port, self.tls, self.username, self.password, self.version)


def mqtt_address(uri: str, notifier_info: tuple[tuple[str, str], ...]) -> MqttAddress:
    """Return the address in `uri` and the settings of `notifierInfo`; raise a problem (400) if it has
    none."""
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    topic = unquote(parts.path).removeprefix("/") if host else ""
    if not host or port == 0 or not topic or len(topic.encode()) > MAX_TOPIC_LENGTH:
        raise bad_request_data(
            "notification.endpoint.uri of an MQTT endpoint names a server and a topic, such as "
            f"mqtt://127.0.0.1:1883/cell/tasks, not {shown(uri)}"
        )
    if "#" in uri or any(sign in topic for sign in "+#\0"):
        raise bad_request_data(
            f"nothing can be published to the topic {shown(topic)}; leave out + and #, which are for reading"
        )
    version, qos = "mqtt5.0", "0"
    for key, value in notifier_info:
        if key == "MQTT-Version":
            version = value
        elif key == "MQTT-QoS":
            qos = value
    if version not in _VERSIONS:
        raise bad_request_data(f"notifierInfo MQTT-Version is {' or '.join(_VERSIONS)}, not {shown(version)}")
    if qos not in _QUALITIES:
        raise bad_request_data(f"notifierInfo MQTT-QoS is {' or '.join(_QUALITIES)}, not {shown(qos)}")
    tls = parts.scheme == "mqtts"
    return MqttAddress(
        host,
        port or (8883 if tls else 1883),
        tls,
        None if parts.username is None else unquote(parts.username),
        None if parts.password is None else unquote(parts.password),
        topic,
        _VERSIONS[version],
        _QUALITIES[qos],
    )
