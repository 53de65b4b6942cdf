"""Where the broker itself is reached, for what it publishes: the @contexts that it hosts have URLs there."""

import re
from dataclasses import dataclass
from typing import Final

_HOST: Final = re.compile(rb"(?:[A-Za-z0-9.\-_]{1,253}|\[[0-9A-Fa-f:.]{2,45}\])(?::[0-9]{1,5})?")


@dataclass(frozen=True, slots=True)
class OwnAddress:
    """Where the broker is reached: as it is told, else by the name it is called, else where it listens."""

    told: str | None
    listens_at: str

    def called(self, host: bytes) -> str:
        """Return the address that goes with a Host header."""
        return f"http://{host.decode()}" if _HOST.fullmatch(host) else self.listens_at
