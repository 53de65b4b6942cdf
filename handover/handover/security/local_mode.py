"""Local mode: while no account exists, a caller on the same machine is the owner.

A request is local only if all of these hold: its address is loopback, its `Host` is a loopback name, and no
proxy passed it on (`Forwarded`, `X-Forwarded-*`, `X-Real-IP`). `Via` is no such sign: brokers of NGSI-LD send
it to each other (clause 6.3.18). A proxy on the same machine would otherwise make the whole network local.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Final

from handover.http.origin_guard import host_and_port
from handover.network.outbound_policy import is_loopback

_FORWARDED_PREFIX: Final = b"\nx-forwarded-"


def is_local(address: str | None, headers: Mapping[bytes, bytes]) -> bool:
    """Return whether a request from `address` is local; `headers` are by name in lower case."""
    if address is None or not is_loopback(address):
        return False
    host = headers.get(b"host")
    if host is not None and not _is_loopback_host(host):  # browsers always send one, some programs do not
        return False
    if b"forwarded" in headers or b"x-real-ip" in headers:
        return False
    # One search through all names, which have no line breaks: a test of each name costs ten times as much.
    return _FORWARDED_PREFIX not in b"\n" + b"\n".join(headers)


@lru_cache(maxsize=1024)
def _is_loopback_host(host: bytes) -> bool:
    parts = host_and_port(host.decode("latin-1"), "http")
    if parts is None:
        return False
    name = parts[0]
    return name.endswith(".localhost") or is_loopback(name.strip("[]"))
