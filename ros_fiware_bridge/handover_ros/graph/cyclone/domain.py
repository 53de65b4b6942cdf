"""The DDS domain: the network interfaces of the bridge and its initial peers.

By default the bridge uses both the network that the machine prefers (multicast, like ROS 2) and the loopback
interface (unicast, since loopback has no multicast). Without a network it uses the loopback interface alone.
`CYCLONEDDS_URI` overrides all of this, as in ROS 2.

Two defaults of Cyclone are changed. Cyclone prefers loopback to other interfaces, and would send data for a
peer on the network to loopback, where the peer cannot receive it; so both have the same priority. Cyclone
also prunes a peer that has not answered for 30 s, so it would never find a robot that starts later; so peers
are never pruned.
"""

import os
import threading
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import quoteattr

import structlog

from handover_ros.errors import AdapterUnavailable

log = structlog.get_logger(__name__)

LOOPBACK = "127.0.0.1"
_MAX_DOMAIN_ID = 232  # beyond it the port numbers of the RTPS specification run out


@dataclass(frozen=True, slots=True)
class DomainSettings:
    """Network settings of a domain.

    `interfaces` are names or addresses (default: the network that the machine prefers, and loopback).
    `peers` are addresses for unicast discovery, where multicast does not reach.
    """

    domain_id: int = 0
    interfaces: tuple[str, ...] = ()
    peers: tuple[str, ...] = ()
    multicast: bool = True

    def configurations(self) -> list[str]:
        """Return the XML configurations to try, in order."""
        if self.interfaces:
            return [self._xml([_interface(interface, self.multicast) for interface in self.interfaces])]
        preferred = f'<NetworkInterface autodetermine="true"{_multicast(self.multicast)}/>'
        return [self._xml([preferred, _interface(LOOPBACK, False)]), self._xml([_interface(LOOPBACK, False)])]

    def _xml(self, interfaces: list[str]) -> str:
        peers = "".join(f"<Peer Address={quoteattr(peer)}/>" for peer in (LOOPBACK, *self.peers))
        return (
            '<CycloneDDS><Domain Id="any">'
            f"<General><Interfaces>{''.join(interfaces)}</Interfaces></General>"
            "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
            "<MaxAutoParticipantIndex>100</MaxAutoParticipantIndex>"
            f"<Peers>{peers}</Peers><InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay></Discovery>"
            "</Domain></CycloneDDS>"
        )


def _interface(name: str, multicast: bool) -> str:
    what = "address" if name[0].isdigit() or ":" in name else "name"
    on_loopback = name == "lo" or name.startswith("127.")
    priority = ' priority="0"' if on_loopback else ""
    return (
        f"<NetworkInterface {what}={quoteattr(name)}{priority}{_multicast(multicast and not on_loopback)}/>"
    )


def _multicast(wanted: bool) -> str:
    return "" if wanted else ' multicast="false"'


class _Open:
    """A domain that this process has open, with the number of its users: DDS allows each domain only once."""

    def __init__(self, domain: Any, settings: DomainSettings) -> None:
        self.domain = domain
        self.settings = settings
        self.users = 1


_lock = threading.Lock()
_open: dict[int, _Open] = {}


def enter(settings: DomainSettings) -> None:
    """Open the domain, or share it if this process has opened it already.

    Raises:
        AdapterUnavailable: the domain cannot be opened.
    """
    from cyclonedds.core import DDSException  # noqa: PLC0415 - heavy
    from cyclonedds.domain import Domain  # noqa: PLC0415

    number = settings.domain_id
    if not 0 <= number <= _MAX_DOMAIN_ID:
        raise AdapterUnavailable(f"there is no ROS domain {number}; use a number from 0 to {_MAX_DOMAIN_ID}")
    with _lock:
        domain = _open.get(number)
        if domain is not None:
            if domain.settings != settings:
                raise AdapterUnavailable(
                    f"ROS domain {number} is open in this process with other settings ({domain.settings}); "
                    "use the same settings, or another domain"
                )
            domain.users += 1
            return
        faults = []
        override = os.environ.get("CYCLONEDDS_URI")
        for configuration in settings.configurations():
            whole = f"{configuration},{override}" if override else configuration
            try:
                _open[number] = _Open(Domain(number, whole), settings)
            except (DDSException, UnicodeEncodeError) as error:
                faults.append(str(error))
            else:
                if faults:
                    log.warning(
                        "no network for ROS except loopback; only programs on this machine are reachable"
                    )
                return
        wanted = ", ".join(settings.interfaces) or "any network"
        raise AdapterUnavailable(
            f"ROS domain {number} cannot be opened on {wanted}; check the names of the interfaces"
            f"{' and CYCLONEDDS_URI' if override else ''} ({faults[-1]})"
        )


def leave(settings: DomainSettings) -> None:
    """Leave the domain; the last user closes it."""
    with _lock:
        domain = _open[settings.domain_id]
        domain.users -= 1
        if not domain.users:
            del _open[settings.domain_id]
            domain.domain.__del__()
