"""The other replicas at the leader: each relays the devices that are connected to it, as an edge does.

A replica stores what its devices send, and acknowledges it to them. So the leader only applies what it gets:
the latest values, rules for anomalies, answers to commands. It gets all devices with the hashes of their
credentials, since a device may connect to any replica.
"""

from collections.abc import Mapping
from hmac import compare_digest
from typing import Any

from handover.telemetry import get_logger
from handover_devices import metrics
from handover_devices.gateway import DeviceGateway, Respond
from handover_devices.protocol.relaying import MAX_RELAYED_BYTES, Relayed, ReplicaHello
from handover_devices.protocol.times import TimeRule
from handover_devices.refusals import HelloRefused
from handover_devices.registry.device import Device, Link
from handover_devices.relaying import RelaySession

log = get_logger(__name__)


class ReplicaSession(RelaySession):
    """One replica."""

    def __init__(self, replicas: "ReplicaSessions", name: str, link: Link) -> None:
        super().__init__(replicas.gateway, "", link)
        self.replica = name
        self._replicas = replicas
        self._last = 0

    def may_relay(self, device: Device) -> bool:  # noqa: ARG002
        """Return True: a replica relays every device."""
        return True

    def received(self) -> int:
        """Return the number of the last message of this connection."""
        return self._last

    def store(self, device: Device, relayed: Relayed) -> list[Mapping[str, Any]]:
        """Apply a message, which the replica has stored."""
        fault = self.gateway.observe(device, relayed.line, self._replicas.times, MAX_RELAYED_BYTES)
        return [] if fault is None else [{"type": "error", "code": "notApplied", "reason": fault}]

    def acknowledge(
        self,
        answers: list[Mapping[str, Any]],
        last: int | None,
        is_new: bool,  # noqa: ARG002
        respond: Respond,
    ) -> None:
        """Respond once the commands that were answered are durable."""
        if last is not None:
            self._last = last
            answers.append({"type": "ack", "seq": last})
        self.gateway.writer.add().add_done_callback(lambda _: respond(answers))

    def on_end(self) -> None:
        """The replica is away."""
        self._replicas.sessions.discard(self)
        metrics.REPLICAS.dec()
        log.info("replica disconnected", replica=self.replica)


class ReplicaSessions:
    """The replicas that are connected; `token` is that of the term, None while this process does not lead."""

    def __init__(self, gateway: DeviceGateway, times: TimeRule) -> None:
        self.gateway = gateway
        self.times = times
        self.token: str | None = None
        self.sessions: set[ReplicaSession] = set()

    def begin(self, hello: ReplicaHello, link: Link) -> ReplicaSession:
        """Begin the session of a replica; raise `HelloRefused`."""
        if self.token is None:
            raise HelloRefused("noLeader", "this gateway does not lead", retry=True)
        if not compare_digest(hello.token.encode(), self.token.encode()):
            raise HelloRefused("wrongToken", "the token is that of another leader", retry=True)
        session = ReplicaSession(self, hello.replica[:64], link)
        self.sessions.add(session)
        metrics.REPLICAS.inc()
        log.info("replica connected", replica=session.replica)
        return session

    def changed(self, device: Device) -> None:
        """A device was added or changed."""
        for session in tuple(self.sessions):
            session.changed(device)

    def removed(self, name: str) -> None:
        """A device was deleted."""
        for session in tuple(self.sessions):
            session.withdraw(name)

    def close(self) -> None:
        """End all sessions: this process does not lead any more."""
        self.token = None
        for session in tuple(self.sessions):
            session.close("noLeader", "this gateway does not lead any more")
