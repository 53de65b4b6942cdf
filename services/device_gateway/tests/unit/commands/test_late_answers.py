"""A device that begins a command after the gateway has given it up is stopped."""

from collections.abc import Callable

import pytest

from handover.database import connect
from handover_devices.commands.command import CommandState
from handover_devices.protocol.messages import AnswerState, CommandAnswer
from handover_devices.settings import GatewaySettings
from services.device_gateway.tests.unit.commands.test_leader_change import Link
from tests.kit.device_gateways import SENSOR, running_gateway
from tests.kit.waiting import until


@pytest.mark.parametrize("late", [AnswerState.ACCEPTED, AnswerState.RUNNING])
async def test_a_command_that_is_accepted_after_its_deadline_is_cancelled(
    new_database: Callable[[], str], late: AnswerState
) -> None:
    engine = connect(new_database())
    async with running_gateway(engine, GatewaySettings.load()) as gateway:
        await gateway.add("hall-1", SENSOR)
        device, before = gateway.devices["hall-1"], Link()
        gateway.attach("hall-1", before, "b1")
        dispatcher = gateway.dispatcher
        await dispatcher.order("hall-1", SENSOR, "turn", {}, timeout_s=0.5, identifier="m-1")
        gateway.disconnect(device, before)

        async def is_given_up() -> bool:
            return (await dispatcher.find("hall-1", "m-1")).state is CommandState.EXPIRED

        await until(is_given_up)
        again = Link()
        gateway.attach("hall-1", again, "b1")
        assert again.sent == []
        assert dispatcher.answer("hall-1", CommandAnswer("m-1", late))
        assert [one["parameters"] for one in again.sent] == [{"id": "m-1"}]
        assert (await dispatcher.find("hall-1", "m-1")).state is CommandState.EXPIRED
        assert dispatcher.answer("hall-1", CommandAnswer("m-1", AnswerState.DONE))
        assert len(again.sent) == 1
    engine.dispose()
