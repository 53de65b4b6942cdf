"""The DDS domain: which network the bridge speaks on, and with whom it begins.

Without a word of configuration it is heard both on the network that the machine prefers (by multicast, as
ROS 2 does it) and on the machine itself (by unicast, as the loopback interface has no multicast). Where there
is no network, the loopback interface alone is used. `CYCLONEDDS_URI` has the last word, as with ROS 2.

Two defaults of Cyclone are changed. It prefers loopback to other interfaces, and would send what is meant
for a peer on the network over loopback, where it goes nowhere; so both have the same priority. It forgets a
peer that has not answered for 30 s, so a robot that is switched on later would never be found; peers are
kept for good.
"""

import os
import threading
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import quoteattr

import structlog

from ros_fiware_bridge.errors import AdapterUnavailable

log = structlog.get_logger(__name__)

LOOPBACK = "127.0.0.1"
_MOST_DOMAINS = 232  # beyond it the port numbers of the RTPS specification run out


@dataclass(frozen=True, slots=True)
class DomainSettings:
    """`interfaces` are names or addresses (none: the network that the machine prefers, and loopback);
    `peers` are addresses to which we make ourselves known besides, where multicast does not reach.
    """

    domain_id: int = 0
    interfaces: tuple[str, ...] = ()
    peers: tuple[str, ...] = ()
    multicast: bool = True

    def configurations(self) -> list[str]:
        """Return the XML configurations to try, in order."""
        if self.interfaces:
            return [self._xml([_interface(one, self.multicast) for one in self.interfaces])]
        preferred = f'<NetworkInterface autodetermine="true"{_multicast(self.multicast)}/>'
        return [self._xml([preferred, _interface(LOOPBACK, False)]), self._xml([_interface(LOOPBACK, False)])]

    def _xml(self, interfaces: list[str]) -> str:
        peers = "".join(f"<Peer Address={quoteattr(one)}/>" for one in (LOOPBACK, *self.peers))
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
    """A domain that is open in this process, and how many graphs stand on it: DDS allows it only once."""

    def __init__(self, domain: Any, settings: DomainSettings) -> None:
        self.domain = domain
        self.settings = settings
        self.users = 1


_lock = threading.Lock()
_open: dict[int, _Open] = {}


def enter(settings: DomainSettings) -> None:
    """Open the domain, or join it where this process has it open already.

    Raises:
        AdapterUnavailable: it cannot be opened so.
    """
    from cyclonedds.core import DDSException  # noqa: PLC0415 - heavy
    from cyclonedds.domain import Domain  # noqa: PLC0415

    number = settings.domain_id
    if not 0 <= number <= _MOST_DOMAINS:
        raise AdapterUnavailable(f"there is no ROS domain {number}; it is a number from 0 to {_MOST_DOMAINS}")
    with _lock:
        known = _open.get(number)
        if known is not None:
            if known.settings != settings:
                raise AdapterUnavailable(
                    f"ROS domain {number} is open in this process with other settings ({known.settings}); "
                    "use the same, or another domain"
                )
            known.users += 1
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
                    log.warning("no network but loopback for ROS; only programs on this machine are reached")
                return
        wanted = ", ".join(settings.interfaces) or "any network"
        raise AdapterUnavailable(
            f"ROS domain {number} cannot be opened on {wanted}; check the names of the interfaces"
            f"{' and CYCLONEDDS_URI' if override else ''} ({faults[-1]})"
        )


def leave(settings: DomainSettings) -> None:
    """Leave the domain; the last one out closes it."""
    with _lock:
        known = _open[settings.domain_id]
        known.users -= 1
        if not known.users:
            del _open[settings.domain_id]
            known.domain.__del__()
