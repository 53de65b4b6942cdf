"""Leases of Devices: at no time two processes may command one, whatever is slow, paused or restarted."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from handover.database import connect
from handover.tasks.device_lease import LEASE_S, REST_S, Authority, DeviceLease, LeaseState
from handover_processes.operations.device_leases import DeviceLeases
from handover_processes.storage.device_leases import LeaseHolder
from handover_processes.storage.store import Store

DEVICE = "urn:ngsi-ld:Device:demo:arm-1"


class Clock:
    """The time of all processes: it passes where a test says so."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


async def at_once(action: Callable[..., Any], *arguments: Any) -> Any:
    return action(*arguments)


async def always() -> None:
    return


class Client:
    """A process that asks for the lease; each request takes its time in both directions."""

    def __init__(self, name: str, clock: Clock) -> None:
        self.name, self.clock, self.run = name, clock, 0
        self.lease = DeviceLease(DEVICE, clock)
        self.authorities: list[Authority] = []

    async def ask(self, server: DeviceLeases, there_s: float, back_s: float) -> int | None:
        sent_s = self.clock()
        self.clock.now_s += there_s
        holder = LeaseHolder(self.name, f"run-{self.run}", "arm", "cell", 1)
        (answer,) = await server.acquire([DEVICE], holder, LEASE_S)
        self.clock.now_s += back_s
        if not answer.is_granted:
            self.lease.refuse(answer.lease.holder.holder, self.clock())
            return None
        self.lease.grant(answer.lease.number, sent_s + LEASE_S)
        if self.lease.is_held():
            self.authorities.append(self.lease.authority())
        return answer.lease.number

    def restart(self) -> None:
        """Begin as a new process with the same data directory: the one before has ended."""
        self.run += 1
        self.lease, self.authorities = DeviceLease(DEVICE, self.clock), []

    def may_command(self) -> bool:
        return any(authority.is_valid() for authority in self.authorities)


DELAYS = st.floats(0, 15)
EVENTS = st.one_of(
    st.tuples(st.just("ask"), st.integers(0, 2), DELAYS, DELAYS),
    st.tuples(st.just("wait"), st.floats(0, 20)),
    st.tuples(st.just("restart client"), st.integers(0, 2)),
    st.tuples(st.just("restart orchestrator")),
    st.tuples(st.just("release"), st.integers(0, 2)),
)


@given(st.lists(EVENTS, max_size=40))
def test_at_most_one_process_may_command_and_numbers_only_grow(events: list[tuple[Any, ...]]) -> None:
    with TemporaryDirectory() as folder:
        asyncio.run(_replay(events, Path(folder)))


async def _replay(events: list[tuple[Any, ...]], folder: Path) -> None:
    clock = Clock()
    clients = [Client(f"client-{number}", clock) for number in range(3)]
    store = Store(connect(f"sqlite:///{folder / 'orchestrator.db'}"))

    async def started() -> DeviceLeases:
        made = DeviceLeases(store, at_once, always, clock=clock)
        await made.open()
        return made

    server, greatest = await started(), 0
    for name, *details in events:
        if name == "ask":
            client = clients[details[0]]
            before = client.lease.number
            number = await client.ask(server, *details[1:])
            if number is not None and number != before:
                assert number > greatest
                greatest = number
        elif name == "wait":
            clock.now_s += details[0]
        elif name == "restart client":
            clients[details[0]].restart()
        elif name == "restart orchestrator":
            server = await started()
        else:
            client = clients[details[0]]
            client.lease.epoch += 1  # as `DeviceLeases.release` of the kit does before it asks
            await server.release([DEVICE], client.name, f"run-{client.run}")
        assert sum(client.may_command() for client in clients) <= 1, name
    store.close()


async def test_a_lease_that_ended_is_granted_to_another_and_an_old_authority_stays_invalid(
    tmp_path: Path,
) -> None:
    clock = Clock()
    store = Store(connect(f"sqlite:///{tmp_path / 'orchestrator.db'}"))
    server = DeviceLeases(store, at_once, always, clock=clock)
    await server.open()
    first, second = Client("first", clock), Client("second", clock)
    assert await first.ask(server, 0.1, 0.1) == 1
    (authority,) = first.authorities
    assert authority.is_valid()
    assert await second.ask(server, 0, 0) is None
    assert second.lease.state() is LeaseState.TAKEN
    assert second.lease.holder == "first"
    clock.now_s += LEASE_S - REST_S
    assert authority.is_valid()
    assert not authority.may_continue()
    clock.now_s += REST_S
    assert not authority.is_valid()
    assert set(server.unheld()) == {DEVICE}
    clock.now_s += 0.1
    assert await second.ask(server, 0, 0) == 2
    assert await first.ask(server, 0, 0) is None
    clock.now_s += LEASE_S + 1
    assert await first.ask(server, 0, 0) == 3
    assert not authority.is_valid(), "a motion of an earlier lease does not continue"
    assert first.lease.authority().is_valid()
    store.close()
