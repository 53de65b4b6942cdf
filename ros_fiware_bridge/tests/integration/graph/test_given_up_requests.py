"""Requests without an answer, with every adapter: their outcome is unknown, and goals are cancelled."""

import asyncio
import subprocess
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractContextManager, asynccontextmanager
from pathlib import Path

import pytest

from handover_ros.errors import CallTimeout, OutcomeUnknown, ServerLost, ServiceUnavailable
from handover_ros.graph.joining import Adapter, JoinSettings, installed, join
from handover_ros.graph.port import RosGraph
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.integration.graph.conftest import Joined, running_script, true
from tests.kit.skipping import NO_ROS
from tests.kit.waiting import scaled

FIBONACCI = "test_msgs/action/Fibonacci"
TRIGGER = "std_srvs/srv/Trigger"
LEASE_S = 20.0
"""Fast DDS; that of Cyclone DDS is 10 s."""

Program = Callable[[], AbstractContextManager[subprocess.Popen[str]]]

_PAIRS = [
    pytest.param((Adapter.CYCLONE, "own"), id="cyclone"),
    *(
        pytest.param(
            (one, "genuine"),
            id=f"{one.value}-genuine",
            marks=[
                pytest.mark.skipif(Adapter.RCLPY not in installed(), reason=NO_ROS),
                pytest.mark.filterwarnings("ignore::DeprecationWarning"),
            ],
        )
        for one in (Adapter.RCLPY, Adapter.AUTO)
    ),
]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(Adapter.CYCLONE not in installed(), reason="the extra [ros] is not installed"),
]


@pytest.fixture(scope="module", params=_PAIRS)
def pair(request: pytest.FixtureRequest) -> tuple[Adapter, str]:
    adapter, kind = request.param
    return Adapter(adapter), str(kind)


@pytest.fixture
def server(pair: tuple[Adapter, str], domain_id: int, tmp_path: Path) -> Program:
    adapter, kind = pair
    if kind == "genuine":
        return lambda: running_script("genuine_slow_peer.py", str(domain_id), str(tmp_path))
    return lambda: running_script("slow_peer.py", adapter.value, str(domain_id), str(tmp_path))


@pytest.fixture
def sender(pair: tuple[Adapter, str], domain_id: int, tmp_path: Path) -> Program:
    """A program that sends a goal, with the same record of goals as `joined`."""
    arguments = (pair[0].value, str(domain_id), str(tmp_path / "goals.json"))
    return lambda: running_script("goal_sender.py", *arguments)


@pytest.fixture
def log(tmp_path: Path) -> Callable[[], list[str]]:
    def lines() -> list[str]:
        file = tmp_path / "log"
        return file.read_text().split() if file.exists() else []

    return lines


@pytest.fixture
def answer(tmp_path: Path) -> Callable[[], None]:
    """Let the server answer from now on."""
    return (tmp_path / "answer").touch


@pytest.fixture
def joined(pair: tuple[Adapter, str], domain_id: int, store: TypeStore, tmp_path: Path) -> Joined:
    @asynccontextmanager
    async def graph() -> AsyncIterator[RosGraph]:
        settings = JoinSettings(
            node="sender",
            domain_id=domain_id,
            interfaces=("127.0.0.1",),
            goals_file=tmp_path / "goals.json",
        )
        opened = await join(store, settings, pair[0])
        try:
            yield opened
        finally:
            await opened.close()

    return graph


@pytest.mark.nightly
async def test_a_goal_that_is_accepted_after_its_time_limit_is_cancelled(
    joined: Joined, server: Program, log: Callable[[], list[str]], answer: Callable[[], None]
) -> None:
    with server():
        async with joined() as graph:
            action = await graph.action_client("/slow", FIBONACCI)
            assert await action.available(scaled(30))
            with pytest.raises(CallTimeout) as failed:
                await action.send_goal({"order": 900}, timeout_s=2.0)
            assert isinstance(failed.value, OutcomeUnknown)
            await action.close()
            await true(lambda: log() == ["asked"])
            answer()
            await true(lambda: "cancelled" in log(), scaled(60))


@pytest.mark.nightly
async def test_a_goal_of_a_killed_sender_is_cancelled_when_it_is_accepted(
    joined: Joined,
    server: Program,
    sender: Program,
    log: Callable[[], list[str]],
    answer: Callable[[], None],
) -> None:
    with server():
        with sender() as process:
            await true(lambda: log() == ["asked"], scaled(60))
            process.kill()
        async with joined():
            answer()
            await true(lambda: "cancelled" in log(), scaled(60))


@pytest.mark.nightly
async def test_an_active_goal_of_a_killed_sender_is_cancelled(
    joined: Joined,
    server: Program,
    sender: Program,
    log: Callable[[], list[str]],
    answer: Callable[[], None],
) -> None:
    answer()
    with server():
        with sender() as process:
            await true(lambda: "started" in log(), scaled(60))
            process.kill()
        assert "cancelled" not in log()
        async with joined():
            await true(lambda: "cancelled" in log(), scaled(60))


@pytest.mark.nightly
async def test_a_goal_ends_when_its_server_is_killed_and_started_again(
    joined: Joined, server: Program, log: Callable[[], list[str]], answer: Callable[[], None]
) -> None:
    answer()
    async with joined() as graph:
        action = await graph.action_client("/slow", FIBONACCI)
        with server() as first:
            goal = await action.send_goal({"order": 900}, timeout_s=scaled(60))
            waiting = asyncio.ensure_future(goal.result())
            await true(lambda: "started" in log(), scaled(60))
            first.kill()
            first.wait()
            with server():  # within the lease of the first
                with pytest.raises(ServerLost):
                    await asyncio.wait_for(waiting, LEASE_S + scaled(30))
                again = await action.send_goal({"order": 900}, timeout_s=scaled(60))
                assert await again.cancel(scaled(30))
                assert (await again.result(scaled(60))).status.name == "CANCELED"


@pytest.mark.nightly
async def test_a_call_whose_server_is_killed_ends_with_an_unknown_outcome(
    joined: Joined, server: Program, log: Callable[[], list[str]]
) -> None:
    async with joined() as graph:
        with pytest.raises(ServiceUnavailable) as unsent:
            await graph.call("/slow_call", TRIGGER, {}, 0.5)
        assert not isinstance(unsent.value, OutcomeUnknown), "nothing was sent"
        with server() as first:
            waiting = asyncio.ensure_future(graph.call("/slow_call", TRIGGER, {}, 3600.0))
            await true(lambda: log() == ["asked"], scaled(60))
            first.kill()
            first.wait()
            with server(), pytest.raises(ServerLost):
                await asyncio.wait_for(waiting, LEASE_S + scaled(30))
            assert not waiting.cancelled()


@pytest.mark.nightly
async def test_a_call_without_an_answer_has_an_unknown_outcome(
    joined: Joined, server: Program, answer: Callable[[], None]
) -> None:
    with server():
        async with joined() as graph:
            with pytest.raises(CallTimeout) as failed:
                await graph.call("/slow_call", TRIGGER, {}, scaled(10.0))  # of which finding it may take some
            assert isinstance(failed.value, OutcomeUnknown)
            assert "did not answer within" in str(failed.value)
        answer()
