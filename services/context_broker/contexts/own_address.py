"""Where the broker itself is reached, for what it publishes: the @contexts that it hosts have URLs there.

It also tells when somebody else's address is the broker's own.
"""

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Final
from urllib.parse import urlsplit

_HOST: Final = re.compile(rb"(?:[A-Za-z0-9.\-_]{1,253}|\[[0-9A-Fa-f:.]{2,45}\])(?::[0-9]{1,5})?")


@dataclass(frozen=True, slots=True)
class OwnAddress:
    """Where the broker is reached: as it is told, else by the name it is called, else where it listens."""

    told: str | None
    listens_at: str

    def called(self, host: bytes) -> str:
        """Return the address that goes with a Host header."""
        return f"http://{host.decode()}" if _HOST.fullmatch(host) else self.listens_at

    def is_at(self, url: str) -> bool:
        """Say whether a URL without a path (http or https) leads to the broker, as far as its text tells."""
        return url == self.told or _plain(url) == _plain(self.listens_at)


@lru_cache(maxsize=1024)
def _plain(url: str) -> tuple[str, str, int]:
    """Return the scheme, the host (one word for this machine) and the port of a URL."""
    parts = urlsplit(url)
    host = parts.hostname or ""
    is_here = host in {"localhost", "::1"} or host.startswith("127.")
    port = parts.port or (443 if parts.scheme == "https" else 80)
    return parts.scheme, "localhost" if is_here else host, port
