"""The URLs of the broker itself, for the @contexts that it hosts; also recognizes them in other documents."""

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Final
from urllib.parse import urlsplit

_HOST: Final = re.compile(rb"(?:[A-Za-z0-9.\-_]{1,253}|\[[0-9A-Fa-f:.]{2,45}\])(?::[0-9]{1,5})?")


@dataclass(frozen=True, slots=True)
class OwnAddress:
    """The address of the broker: as configured, else the name of the request, else where it listens."""

    configured: str | None
    listens_at: str

    def called(self, host: bytes) -> str:
        """Return the address for a Host header."""
        return f"http://{host.decode()}" if _HOST.fullmatch(host) else self.listens_at

    def is_at(self, url: str) -> bool:
        """Return whether a URL without a path (http or https) is that of the broker, judged by its text."""
        return url == self.configured or _plain(url) == _plain(self.listens_at)


@lru_cache(maxsize=1024)
def _plain(url: str) -> tuple[str, str, int]:
    """Return the scheme, the host (one name for all loopback addresses) and the port of a URL."""
    parts = urlsplit(url)
    host = parts.hostname or ""
    is_here = host in {"localhost", "::1"} or host.startswith("127.")
    port = parts.port or (443 if parts.scheme == "https" else 80)
    return parts.scheme, "localhost" if is_here else host, port
