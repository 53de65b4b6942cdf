"""The client that is copied onto robots: it sends again what was not acknowledged, and executes once."""

import json
import socket
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from handover_devices.device_client import DeviceClient, Run
from tests.kit.waiting import scaled, wait_for


class Gateway:
    """The gateway's end of the connection, scripted by the test."""

    def __init__(self) -> None:
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        self.connection: socket.socket | None = None

    def accept(self, **greeting: Any) -> dict[str, Any]:
        """Accept the next connection and return its hello."""
        self.server.settimeout(scaled(30))
        self.connection, _ = self.server.accept()
        self.connection.settimeout(scaled(30))
        self.lines = self.connection.makefile("rb")
        hello = self.receive()
        self.say(**{"type": "ack", **greeting})
        return hello

    def receive(self) -> dict[str, Any]:
        message: dict[str, Any] = json.loads(self.lines.readline())
        return message

    def say(self, **message: Any) -> None:
        assert self.connection is not None
        self.connection.sendall(json.dumps(message).encode() + b"\n")

    def hang_up(self) -> None:
        assert self.connection is not None
        self.lines.close()
        self.connection.close()


@pytest.fixture
def gateway() -> Iterator[Gateway]:
    made = Gateway()
    yield made
    if made.connection is not None:
        made.hang_up()
    made.server.close()


@pytest.fixture
def client(gateway: Gateway) -> Iterator[DeviceClient]:
    made = DeviceClient("127.0.0.1", gateway.port, "hall-1", "secret")
    yield made
    made.stop()


def test_what_was_not_acknowledged_is_sent_again_with_its_time(
    gateway: Gateway, client: DeviceClient
) -> None:
    client.send({"temperature": 1.0}, t=100.0)  # buffered before the first connection
    client.start()
    assert gateway.accept()["device"] == "hall-1"
    first = gateway.receive()
    gateway.say(type="ack", seq=first["seq"])
    client.send({"temperature": 2.0}, t=101.0)
    lost = gateway.receive()
    wait_for(lambda: client.waiting() == 1)
    gateway.hang_up()
    gateway.accept()
    assert gateway.receive() == lost
    gateway.say(type="error", seq=lost["seq"], code="unknownValue", reason="no such value")
    wait_for(lambda: client.waiting() == 0)  # it would be refused again
    with pytest.raises(ValueError):
        client.send({"temperature": float("nan")})


def test_a_command_that_arrives_again_is_not_executed_again(gateway: Gateway, client: DeviceClient) -> None:
    executions, may_end = [], threading.Event()

    @client.command("turn")
    def turn(parameters: dict[str, Any], run: Run) -> dict[str, Any]:
        executions.append(run.id)
        run.progress(0.5)
        may_end.wait(scaled(30))
        return {"rad": parameters["rad"]}

    client.start()
    hello = gateway.accept()
    assert hello["takes"] == ["turn"]
    command = {"type": "command", "id": "c-1", "name": "turn", "parameters": {"rad": 1.0}}
    gateway.say(**command)
    assert gateway.receive() == {"type": "ack", "id": "c-1", "state": "accepted"}
    assert gateway.receive()["progress"] == 0.5
    gateway.say(**command)
    assert gateway.receive()["state"] == "running"  # its last answer
    gateway.hang_up()  # the end is not lost with the connection
    may_end.set()
    assert gateway.accept()["boot"] == hello["boot"]
    gateway.say(**command)
    wait_for(
        lambda: gateway.receive() == {"type": "ack", "id": "c-1", "state": "done", "result": {"rad": 1.0}}
    )
    gateway.say(type="command", id="c-2", name="fly", parameters={})
    wait_for(lambda: gateway.receive().get("id") == "c-2")
    assert executions == ["c-1"]


def test_a_cancelled_command_ends_with_an_error(gateway: Gateway, client: DeviceClient) -> None:
    @client.command("turn")
    def turn(_: dict[str, Any], run: Run) -> None:
        run.cancelled.wait(scaled(30))

    client.start()
    gateway.accept()
    gateway.say(type="command", id="c-1", name="turn", parameters={})
    assert gateway.receive()["state"] == "accepted"
    gateway.say(type="command", id="c-1:cancel", name="cancel", parameters={"id": "c-1"})
    assert gateway.receive() == {"type": "error", "reason": "stopped", "id": "c-1"}


def test_a_refused_device_does_not_connect_again(gateway: Gateway, client: DeviceClient) -> None:
    client.start()
    gateway.accept(type="error", code="replaced", reason="another connection", retry=False)
    assert wait_for(lambda: client.refused) == "another connection"
