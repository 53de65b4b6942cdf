"""The sketch for an ESP32 speaks the protocol: the lines that it sends are replayed to a gateway.

No compiler for it is needed: the statements that fill and send each JSON document are read from the sketch. A
statement or an expression that is not understood fails the test, so that it does not pass unseen.
"""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from handover.database import connect
from handover_devices.commands.command import CommandState
from handover_devices.model.description import DeviceDescription
from handover_devices.protocol import messages
from handover_devices.protocol.lines import LineBuffer
from handover_devices.protocol.messages import BadMessage, parse_hello
from handover_devices.refusals import HelloRefused
from handover_devices.settings import GatewaySettings
from tests.kit.device_gateways import running_gateway
from tests.kit.paths import REPOSITORY

EXAMPLE = REPOSITORY / "examples" / "esp32_sensor"
SKETCH = (EXAMPLE / "esp32_sensor.ino").read_text(encoding="utf-8")
DESCRIPTION = DeviceDescription.model_validate(yaml.safe_load((EXAMPLE / "sensor.yaml").read_text()))
SECONDS = 2.5

_STRING = r'"(?:\\.|[^"\\])*"'
_PATH = r'((?:\["\w+"\])+)'


class NotUnderstood(AssertionError):
    """The sketch has something that this test does not know."""


class Sketch:
    """The documents that each function of the sketch sends."""

    def __init__(self, source: str) -> None:
        self.source = re.sub(rf"({_STRING})|//[^\n]*", lambda found: found[1] or "", source)
        declared = re.findall(
            r"^(?:const )?(?:char \*|String |uint\d+_t )(\w+) = (.+?);", self.source, re.MULTILINE
        )
        self.globals: dict[str, str] = dict(declared)
        self.seq = 0

    def body(self, function: str) -> str:
        """Return the text between the braces of a function."""
        found = re.search(rf"^void {function}\([^)]*\) \{{\n(.*?)^\}}", self.source, re.MULTILINE | re.DOTALL)
        if found is None:
            raise NotUnderstood(f"there is no function {function}")
        return found[1]

    def sent_by(self, function: str, **values: Any) -> bytes:
        """Return the line that a function sends; `values` are those of its parameters."""
        sending = [line.strip() for line in self.body("send").splitlines()]
        if sending != ["serializeJson(message, gateway);", r"gateway.print('\n');"]:
            raise NotUnderstood(f"send does more than write a line: {sending}")
        found = re.findall(r"JsonDocument (\w+);(.*?)\n\s*send\(\1\);", self.body(function), re.DOTALL)
        if len(found) != 1:
            raise NotUnderstood(f"{function} does not send one document")
        ((name, statements),) = found
        document: dict[str, Any] = {}
        for statement in filter(None, (one.strip() for one in statements.split(";"))):
            self._execute(name, statement, document, values)
        return json.dumps(document, separators=(",", ":")).encode() + b"\n"

    def _execute(self, name: str, statement: str, document: dict[str, Any], values: dict[str, Any]) -> None:
        assigned = re.fullmatch(rf"{name}{_PATH} = (.+)", statement)
        added = re.fullmatch(rf"{name}{_PATH}\.add\((.+)\)", statement)
        found = assigned or added
        if found is None:
            raise NotUnderstood(statement)
        *parents, last = re.findall(r'"(\w+)"', found[1])
        for parent in parents:
            document = document.setdefault(parent, {})
        value = self._value(found[2], values)
        if assigned:
            document[last] = value
        else:
            document.setdefault(last, []).append(value)

    def _value(self, expression: str, values: dict[str, Any]) -> Any:
        if re.fullmatch(rf"{_STRING}|\d+", expression):
            return json.loads(expression)
        if expression in values:
            return values[expression]
        if expression == "++seq":
            self.seq += 1
            return self.seq
        if expression == "temperatureRead()":
            return 53.33333206  # a float with the digits that ArduinoJson writes
        if expression == "String(esp_random(), HEX)":
            return "9f3c11d0"
        if expression in self.globals:
            return self._value(self.globals[expression], values)
        raise NotUnderstood(expression)


class Wire:
    """Keeps what the gateway sends."""

    boot = ""

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def send(self, message: Any) -> None:
        self.sent.append(message)

    def send_latest(self, message: Any) -> bool:
        self.sent.append(message)
        return True

    def end(self, code: str, reason: str, *, retry: bool) -> None:
        self.sent.append({"type": "error", "code": code, "reason": reason, "retry": retry})


async def replay(source: str, folder: Path) -> None:
    """Replay the sketch to a gateway, with the token of its device, and compare the answers."""
    sketch, wire, lines = Sketch(source), Wire(), LineBuffer()
    engine = connect(f"sqlite:///{folder / 'devices.db'}")
    async with running_gateway(engine, GatewaySettings.load(data_dir=folder)) as gateway:
        made = await gateway.add("hall-1", DESCRIPTION)
        (line,) = lines.feed(sketch.sent_by("connectToGateway", TOKEN=made.token))
        hello = parse_hello(line)
        session = gateway.connect(hello, wire)
        greeting = gateway.greeting(hello, session.device)
        assert (greeting["type"], greeting.get("unknown")) == ("ack", None)
        assert set(hello.measures) == set(session.device.values)
        assert set(hello.takes) == {command.name for command in DESCRIPTION.commands}
        assert wire.boot == hello.boot != ""

        async def answers(given: bytes) -> list[Any]:
            found: list[Any] = []
            await gateway.receive(session.device, lines.feed(given), found.extend)
            return found

        for seq in (1, 2):
            assert await answers(sketch.sent_by("loop")) == [{"type": "ack", "seq": seq}]
        assert session.device.latest["temperature"].value == pytest.approx(53.333, abs=1e-3)
        taken = await gateway.dispatcher.order(
            "hall-1", DESCRIPTION, "setInterval", {"seconds": SECONDS}, timeout_s=3600
        )
        while not wire.sent:
            taken = await gateway.dispatcher.wait("hall-1", taken.id, taken, 0.05)
        (message,) = wire.sent
        assert (message["type"], message["name"]) == ("command", hello.takes[0])
        assert await answers(sketch.sent_by("answer", id=message["id"])) == []
        done = await gateway.dispatcher.wait("hall-1", taken.id, taken, 60)
        assert done.state is CommandState.DONE
    engine.dispose()


async def test_the_gateway_accepts_every_line_of_the_sketch(tmp_path: Path) -> None:
    await replay(SKETCH, tmp_path)


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ('hello["version"] = 1', 'hello["version"] = 2'),
        ('hello["token"] = TOKEN', 'hello["token"] = "another"'),
        ('hello["boot"] = boot', 'hello["boot"] = "two words"'),
        ('hello["boot"] = boot', 'hello["start"] = boot'),
        ('["measures"].add("temperature")', '["measures"].add("heat")'),
        ('["takes"].add("setInterval")', '["takes"].add("interval")'),
        ('"telemetry"', '"telemetri"'),
        ('message["seq"] = ++seq', 'message["seq"] = "1"'),
        ('message["values"]["temperature"]', 'message["values"]["heat"]'),
        ('message["values"]["temperature"]', 'message["temperature"]'),
        ('message["id"] = id;\n', 'message["command"] = id;\n'),
        ('message["type"] = "ack"', 'message["type"] = "done"'),
        ("gateway.print('\\n')", "gateway.print(';')"),
        ("= temperatureRead()", "= NAN"),
    ],
)
async def test_a_wrong_change_of_the_sketch_is_found(right: str, wrong: str, tmp_path: Path) -> None:
    assert right in SKETCH
    with pytest.raises((AssertionError, BadMessage, HelloRefused)):
        await replay(SKETCH.replace(right, wrong, 1), tmp_path)


def test_the_sketch_reads_what_the_gateway_sends() -> None:
    documented = str(messages.__doc__).partition("To the device:")[2]
    sent = [json.loads(line) for line in re.findall(r"^ +(\{.*\})$", documented, re.MULTILINE)]
    types = {one["type"] for one in sent}
    body = Sketch(SKETCH).body("receive")
    assert set(re.findall(r'strcmp\(type, "(\w+)"\)', body)) == types == {"ack", "error", "command"}
    assert set(re.findall(r'message\["(\w+)"\]', body)) <= {name for one in sent for name in one}
    (command,) = DESCRIPTION.commands
    assert re.findall(r'strcmp\(message\["name"\] \| "", "(\w+)"\)', body) == [command.name]
    assert command.parameters is not None
    assert set(re.findall(r'\["parameters"\]\["(\w+)"\]', body)) == set(command.parameters["properties"])


def test_the_sketch_waits_before_each_attempt_to_connect() -> None:
    body = Sketch(SKETCH).body("connectToGateway")
    assert 0 < body.find("delay(delayMs)") < body.find("gateway.connect(")


def test_the_device_of_the_readme_is_that_of_the_sketch() -> None:
    name = json.loads(Sketch(SKETCH).globals["DEVICE"])
    readme = (EXAMPLE / "README.md").read_text()
    assert f"handover device add {name} --file examples/esp32_sensor/sensor.yaml" in readme


def test_an_interval_of_the_sketch_is_shorter_than_the_idle_time_of_the_gateway() -> None:
    (command,) = DESCRIPTION.commands
    assert command.parameters is not None
    idle_s = GatewaySettings.model_fields["device_idle_timeout_s"].default
    assert command.parameters["properties"]["seconds"]["maximum"] < idle_s
