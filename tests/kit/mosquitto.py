"""A real MQTT server for tests."""

import getpass
import json
import shutil
import subprocess
import threading
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

PASSWORD = "let-me-in"


class Mosquitto:
    """An MQTT server on a port of its own, and a client that is subscribed to all topics."""

    def __init__(self, folder: Path, port: int, safe_port: int, certificate: tuple[Path, Path]) -> None:
        program = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
        if not Path(program).exists():
            pytest.skip("mosquitto is not installed; apt-get install mosquitto")
        self.port, self.safe_port = port, safe_port
        self.received: list[tuple[str, int, dict[str, Any]]] = []
        self._command = [program, "-c", str(folder / "mosquitto.conf")]
        passwords = folder / "passwords"
        known = ["mosquitto_passwd", "-b", "-c", str(passwords), "cell", PASSWORD]
        subprocess.run(known, check=True, capture_output=True)
        (folder / "mosquitto.conf").write_text(
            f"user {getpass.getuser()}\nper_listener_settings true\npersistence false\n"
            f"listener {port} 127.0.0.1\nallow_anonymous true\n"
            f"listener {safe_port} 127.0.0.1\nallow_anonymous false\npassword_file {passwords}\n"
            f"certfile {certificate[0]}\nkeyfile {certificate[1]}\n"
        )
        self.process: subprocess.Popen[bytes] | None = None
        self._client = Client(CallbackAPIVersion.VERSION2)
        self._client.on_message = self._take
        self._client.on_connect = lambda client, *_: client.subscribe("#", 2)
        self.is_listening = threading.Event()
        self._client.on_subscribe = lambda *_: self.is_listening.set()

    def start(self) -> None:
        self.is_listening.clear()
        self.process = subprocess.Popen(
            self._command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )

    def listen(self) -> None:
        self._client.reconnect_delay_set(1, 1)
        self._client.connect_async("127.0.0.1", self.port)
        self._client.loop_start()
        assert self.is_listening.wait(120), "nobody could listen to Mosquitto"

    def stop(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait(120)
            self.process = None

    def close(self) -> None:
        self._client.loop_stop()
        self._client.disconnect()
        self.stop()

    def of(self, topic: str) -> list[dict[str, Any]]:
        return [message for at, _, message in list(self.received) if at == topic]

    def _take(self, _: Client, __: Any, message: MQTTMessage) -> None:
        self.received.append((message.topic, message.qos, json.loads(message.payload)))
