"""A gateway that does not lead any more writes no command, and therefore sends none."""

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from sqlalchemy import Engine

from handover.database import connect
from handover.errors import Problem
from handover_devices.settings import GatewaySettings
from handover_devices.storage import device_store, leader_store
from handover_devices.storage.leader_store import Leader
from tests.kit.device_gateways import SENSOR, running_gateway
from tests.kit.waiting import until


class Link:
    """A device that notes what it gets."""

    boot = "b1"

    def __init__(self) -> None:
        self.sent: list[Mapping[str, Any]] = []

    def send(self, message: Mapping[str, Any]) -> None:
        self.sent.append(message)

    def send_latest(self, message: Mapping[str, Any]) -> bool:
        self.sent.append(message)
        return True

    def end(self, code: str, reason: str, *, retry: bool) -> None:
        """Nothing is open."""


def begin_term(engine: Engine) -> int:
    with engine.begin() as connection:
        return leader_store.begin_term(connection, Leader("127.0.0.1", 1, 2, "", "token"))


async def test_a_deposed_leader_sends_no_command_and_says_so(new_database: Callable[[], str]) -> None:
    engine = connect(new_database())
    async with running_gateway(engine, GatewaySettings.load()) as gateway:
        await gateway.add("hall-1", SENSOR)
        link = Link()
        gateway.attach("hall-1", link, "b1")
        dispatcher, writer = gateway.dispatcher, gateway.writer
        writer.term = begin_term(engine)
        assert leader_store.find(engine) == Leader("127.0.0.1", 1, 2, "", "token")
        made = await dispatcher.order("hall-1", SENSOR, "turn", {}, timeout_s=60, identifier="m-1")
        assert (made.state, [one["id"] for one in link.sent]) == ("sent", ["m-1"])

        assert begin_term(engine) == writer.term + 1, "another process leads, and this one has not noticed"
        for kind, identifier in (("turn", "m-2"), ("beep", "a-2")):
            order = dispatcher.order("hall-1", SENSOR, kind, {}, timeout_s=60, identifier=identifier)
            ordering = asyncio.ensure_future(order)
            await until(lambda one=identifier: ("hall-1", one) in writer._group.commands)
            await writer.call(lambda _: None)  # after the first attempt to write it
            gateway.receive(gateway.devices["hall-1"], [b'{"type":"event","name":"e"}'], lambda _: None)
            dispatcher.clear()  # it notices
            writer.discard_commands()
            with pytest.raises(Problem, match="another gateway took over"):
                await ordering
            assert device_store.command(engine, "hall-1", identifier) is None
            dispatcher.connect("hall-1", link)
        assert [one["id"] for one in link.sent] == ["m-1"]

        writer.term = begin_term(engine)  # it leads again
        await gateway.load()
        beep = await dispatcher.order("hall-1", SENSOR, "beep", {}, timeout_s=60, identifier="a-3")
        await until(lambda: "a-3" in [one["id"] for one in link.sent])
        assert beep.boot == "b1"
    engine.dispose()
