"""Which gloves may connect: tokens, slots, and a glove that comes back after its network was cut."""

import asyncio
import re
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import orjson
import pytest
import websockets

from tests.kit.cell import Cell
from tests.kit.gloves import TcpGlove
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

UP, OPEN = "02222", "00000"


@pytest.mark.nightly
async def test_after_a_network_cut_a_glove_takes_its_place_again_and_its_task_goes_on(
    bench: Any, put_on: Callable[..., TcpGlove]
) -> None:
    half_open = put_on()  # what the controller still has of it: a connection that will say nothing more
    half_open.show(OPEN, 0.2)
    task = await bench.put("t1", commandId=3)

    async def is_asked() -> bool:
        return bool((bench.view()["task"] or {}).get("id") == task)

    await until(is_asked, 60, "the Task is asked for")
    back: list[TcpGlove] = []

    async def is_admitted() -> bool:
        glove = await asyncio.to_thread(put_on)
        if glove.answer["type"] == "ack":
            back.append(glove)
            return True
        assert "another connection of glove-1 is in use" in glove.answer["reason"]
        assert glove.answer["retry"] is True, "its bridge must go on trying"
        glove.close()
        return False

    await until(is_admitted, 60, "the glove is admitted again")
    answer = await asyncio.to_thread(half_open.link.recv, 4096)
    assert "since this connection was silent" in orjson.loads(answer)["reason"]
    back[0].show(OPEN, 0.2)
    back[0].show(UP, 1.8)

    async def is_completed() -> bool:
        return bool(await bench.status(task) == "completed")

    await until(is_completed, 60, "the Task is completed")


def handover(cell: Cell, *words: str) -> "subprocess.CompletedProcess[str]":
    """Run the command line."""
    return subprocess.run(
        [sys.executable, "-m", "handover_cell", *words],
        env=cell.environment,
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.nightly
async def test_a_token_is_made_on_the_command_line_and_shown_once(
    bench: Any, put_on: Callable[..., TcpGlove]
) -> None:
    made = await asyncio.to_thread(handover, bench.cell, "glove", "token", "glove-7")
    assert made.returncode == 0, made.stderr
    token = made.stdout.splitlines()[1]
    assert re.fullmatch(r"hnd_glove_[A-Za-z0-9_-]{43}", token)
    refused = put_on("glove-7")
    assert "glove-7 has a token of its own" in refused.answer["reason"]
    glove = put_on("glove-7", token=token)
    assert glove.answer["type"] == "ack"
    assert token not in bench.screen.get("/gloves").text
    assert token not in bench.cell.log("gesture_controller")
    removed = await asyncio.to_thread(handover, bench.cell, "glove", "token", "glove-7", "--remove")
    assert removed.returncode == 0, removed.stderr
    assert put_on("glove-7").answer["type"] == "ack"
    wrong = await asyncio.to_thread(handover, bench.cell, "glove", "token", "glove-7", "--remove")
    assert wrong.returncode == 2
    assert "glove-7 has no token of its own" in wrong.stderr


@pytest.fixture
def tenant_cell(tenant_cell: Cell, request: pytest.FixtureRequest) -> Cell:
    """A cell with the settings that a test wants."""
    tenant_cell.extra |= getattr(request, "param", {})
    return tenant_cell


@pytest.mark.parametrize(
    "tenant_cell",
    [{"HANDOVER_MAX_UNDECLARED_GLOVES": "3", "HANDOVER_GLOVE_FORGET_S": "0.5"}],
    indirect=True,
)
async def test_slots_of_invented_names_become_free_again_and_a_glove_that_returns_gets_its_task(
    bench: Any, put_on: Callable[..., TcpGlove]
) -> None:
    invented = [put_on(f"invented-{nth}") for nth in range(3)]
    refused = put_on("mine")
    assert "3 gloves that nobody declared are known already" in refused.answer["reason"]
    assert put_on("glove-1").answer["type"] == "ack", "a glove of the gestures file is not kept away"
    url = f"{bench.cell.url('gesture_controller')}/gloves/invented-0/live".replace("http", "ws", 1)
    async with websockets.connect(url, proxy=None) as screen:
        await screen.recv()
        for glove in invented:
            glove.close()
        async with asyncio.timeout(120):
            await screen.wait_closed()
        assert screen.close_code == 4404

    async def are_forgotten() -> bool:
        return not any("invented" in one["glove"] for one in bench.screen.get("/gloves").json())

    await until(are_forgotten, 60, "the invented gloves are forgotten")
    task = await bench.put("t1", "urn:ngsi-ld:Device:demo:invented-1", gesture="Thumbs up")
    glove = put_on("invented-1")
    assert glove.answer["type"] == "ack"

    async def is_asked() -> bool:
        return bool((bench.view("invented-1")["task"] or {}).get("id") == task)

    await until(is_asked, 60, "the Task of the glove that returned")
    glove.show(OPEN, 0.2)
    glove.show(UP, 1.8)

    async def is_completed() -> bool:
        return bool(await bench.status(task) == "completed")

    await until(is_completed, 60, "the Task is completed")
