"""What a replica does while another one leads: it relays its devices to the leader, as an edge does.

The leader is found in the database. Devices keep their connections when the leader changes, and what they
send is stored and acknowledged meanwhile. Commands, REST and rules for anomalies wait for the next leader.
"""

import asyncio
from contextlib import suppress
from typing import Final

from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from handover.network.tls_trust import client_context
from handover.runtime.retry import Backoff
from handover.telemetry import get_logger
from handover_devices.edge.commands import EdgeCommands, EdgeDispatcher
from handover_devices.edge.edge_app import NoReports
from handover_devices.edge.uplink import Uplink
from handover_devices.edge.upstream import Upstream
from handover_devices.gateway import DeviceGateway
from handover_devices.protocol.relaying import MAX_RELAYED_BYTES
from handover_devices.protocol.times import TimeRule
from handover_devices.relaying import EdgeRelays
from handover_devices.replicas.message_queue import MemoryQueue
from handover_devices.settings import GatewaySettings
from handover_devices.storage import leader_store
from handover_devices.storage.device_store import StoredDevice
from handover_devices.storage.leader_store import Leader

log = get_logger(__name__)

MAX_RETRY_S: Final = 1.0
"""A new leader is found at most so much later."""
NOBODY: Final = Upstream("", 0, {})


class LeaderUplink(Uplink):
    """The connection with the leader; what it says about devices is in the database already."""

    async def mirror(self, stored: StoredDevice) -> None:
        """Use a device as the leader has stored it."""
        self._gateway.adopt(stored)

    async def remove(self, name: str) -> None:
        """Forget a device that was deleted."""
        self._gateway.drop(name)


class Following:
    """Relays to the leader between `begin` and `end`."""

    def __init__(
        self,
        settings: GatewaySettings,
        engine: Engine,
        gateway: DeviceGateway,
        times: TimeRule,
        relays: EdgeRelays,
    ) -> None:
        self.leader: Leader | None = None
        """The leader as it was found last."""
        self.is_active = False
        """Whether another process leads, or none: requests are passed on."""
        self._settings = settings
        self._engine = engine
        self._gateway = gateway
        self._times = times
        self._relays = relays
        self._queue = MemoryQueue()
        self._dispatcher = EdgeDispatcher(engine, gateway.writer)
        self._uplink: LeaderUplink | None = None
        self._task: asyncio.Task[None] | None = None

    def begin(self) -> None:
        """Begin to relay to the leader."""
        gateway = self._gateway
        commands = EdgeCommands(gateway, self._settings.edge_max_motion_delay_s, is_replica=True)
        self._uplink = LeaderUplink(
            NOBODY,
            gateway,
            self._dispatcher,
            commands,
            self._queue,
            cancel_motions_after_s=self._settings.edge_cancel_motions_after_s,
        )
        gateway.dispatcher, gateway.reports, gateway.writer.outbox = (
            self._dispatcher,
            NoReports(),
            self._queue,
        )
        gateway.on_changed, gateway.on_removed = self._relays.changed, self._relays.removed
        gateway.on_values = lambda *_: None
        self.is_active = True
        self._task = asyncio.create_task(self._run(self._uplink))

    async def end(self) -> None:
        """End the connection with the leader: this process begins to lead, or ends."""
        self.leader = None
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task
        self._gateway.writer.outbox = None
        self._gateway.relay_live = None
        self._uplink = None

    def take_over(self) -> None:
        """Apply what the dead leader has not acknowledged, and pass no more requests on.

        The commands must be loaded.
        """
        self.is_active = False
        for row in self._queue.take_all():
            device = self._gateway.devices.get(row.device)
            if device is not None:
                self._gateway.observe(device, row.body.encode(), self._times, MAX_RELAYED_BYTES)

    async def check(self) -> None:
        """Raise an error, with the reason, while this replica is not connected with the leader."""
        if self.is_active and not (self._uplink and self._uplink.is_connected):
            fault = "" if self._uplink is None else self._uplink.fault
            raise ConnectionError(f"not connected with the gateway that leads: {fault}")

    async def _run(self, uplink: LeaderUplink) -> None:
        backoff = Backoff(initial_s=0.1, max_s=MAX_RETRY_S)
        while True:
            try:
                leader = await asyncio.to_thread(leader_store.find, self._engine)
            except SQLAlchemyError as error:
                log.warning("leader not looked up", error=str(error).splitlines()[0])
            else:
                self.leader = leader
                if leader is not None:
                    uplink.upstream = self._upstream(leader)
                    await uplink.try_once(backoff)
            await backoff.wait()

    def _upstream(self, leader: Leader) -> Upstream:
        tls = client_context(*self._settings.ca_files) if leader.tls_name else None
        hello = {"replica": self._settings.instance or self._settings.replica_host, "token": leader.token}
        return Upstream(leader.host, leader.device_port, hello, tls, leader.tls_name or None)
