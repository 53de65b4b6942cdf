"""What a replica begins with when it leads: a term, in which the other replicas find it."""

import asyncio
from functools import partial

from handover.security.secret_tokens import new_token
from handover.serving.leadership import Leadership
from handover_devices.gateway import DeviceGateway
from handover_devices.settings import GatewaySettings
from handover_devices.storage import leader_store
from handover_devices.storage.leader_store import Leader


def leader_at(settings: GatewaySettings, tls_name: str) -> Leader:
    """Return where other replicas reach this process, with a new token."""
    return Leader(
        settings.replica_host,
        settings.device_port,
        settings.gateway_port,
        tls_name,
        new_token("replica"),
    )


async def begin_term(leadership: Leadership, gateway: DeviceGateway, leader: Leader) -> None:
    """Begin a term: from now on the former leader writes no command any more."""
    if gateway.is_shared:
        gateway.writer.term = await asyncio.to_thread(partial(_begin, leadership, leader))


def _begin(leadership: Leadership, leader: Leader) -> int:
    with leadership.transaction() as connection:
        return leader_store.begin_term(connection, leader)
