"""A client of the dashboard server: one line for each command and each answer.

It has no command that ends a protective stop, a safeguard stop or an emergency stop.
"""

import asyncio

from handover.errors import HandoverError

TIMEOUT_S = 3.0
MAX_ANSWER_BYTES = 1000


class DashboardError(HandoverError):
    """The dashboard server cannot be asked, or rejects a command; the message has its answer."""


class Dashboard:
    """The dashboard server of one controller; each command uses a connection of its own."""

    def __init__(self, host: str, port: int) -> None:
        self._host = host
        self._port = port

    async def is_in_remote_control(self) -> bool | None:
        """Return whether the controller accepts programs; None where it does not have the two modes."""
        answer = await self._ask("is in remote control")
        return {"true": True, "false": False}.get(answer.lower())

    async def describe(self) -> dict[str, str]:
        """Return model, serial number and software version as the controller states them."""
        return {
            "model": await self._ask("get robot model"),
            "serialNumber": await self._ask("get serial number"),
            "software": await self._ask("PolyscopeVersion"),
        }

    async def power_on(self) -> None:
        """Power the arm; its brakes stay closed."""
        await self._require("power on", "Powering on")

    async def power_off(self) -> None:
        """Remove the power of the arm; its brakes close."""
        await self._require("power off", "Powering off")

    async def release_brakes(self) -> None:
        """Release the brakes; the arm may move a little."""
        await self._require("brake release", "Brake releasing")

    async def _require(self, command: str, expected: str) -> None:
        answer = await self._ask(command)
        if not answer.startswith(expected):
            raise DashboardError(f'the controller rejects "{command}": {answer}')

    async def _ask(self, command: str) -> str:
        try:
            async with asyncio.timeout(TIMEOUT_S):
                reader, writer = await asyncio.open_connection(self._host, self._port, limit=MAX_ANSWER_BYTES)
                try:
                    await reader.readline()
                    writer.write(f"{command}\n".encode())
                    line = await reader.readline()
                finally:
                    writer.close()
        except (OSError, TimeoutError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error) or "no answer"
            raise DashboardError(f"the dashboard server {self._host}:{self._port}: {reason}") from None
        if not line.endswith(b"\n"):
            raise DashboardError(f"the dashboard server {self._host}:{self._port} closed the connection")
        return line.decode(errors="replace").strip()
