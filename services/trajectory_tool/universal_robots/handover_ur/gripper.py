"""The gripper at the flange: none, one at the tool outputs, or one of Robotiq through its URCap."""

import asyncio
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping

from handover_robots.model.faults import RobotFault
from handover_ur.options import UrOptions
from handover_ur.shared_memory import Report

TOOL_INPUT_BIT = TOOL_OUTPUT_BIT = 16
CHECK_EVERY_S = 0.02
ANSWER_TIMEOUT_S = 2.0
MOVE_TIMEOUT_S = 10.0
OUTPUT_TIMEOUT_S = 2.0
_ACTIVE = 3
_MOVING, _CLOSED_ON_OBJECT = 0, 2
_RANGE = 255


class UrGripper(ABC):
    """A gripper that opens and closes."""

    @abstractmethod
    async def close(self) -> bool:
        """Close; return whether an object is between the fingers. Raises `RobotFault`."""

    @abstractmethod
    async def open(self) -> None:
        """Open. Raises `RobotFault`."""


class NoGripper(UrGripper):
    """The arm has no gripper."""

    async def close(self) -> bool:
        """Raise `RobotFault`."""
        raise self._fault()

    async def open(self) -> None:
        """Raise `RobotFault`."""
        raise self._fault()

    @staticmethod
    def _fault() -> RobotFault:
        return RobotFault.translated(
            "robot.ur_no_gripper",
            "no gripper is configured; set gripper to tool_io or robotiq in the settings of the driver",
        )


class ToolOutputGripper(UrGripper):
    """A gripper that closes while a tool output is high.

    `set_output` sets the outputs by mask and value. Without an input for the gripped object,
    `something_there` is the answer.
    """

    def __init__(
        self,
        options: UrOptions,
        report: Callable[[], Report],
        set_output: Callable[[int, int], None],
        acts_in_s: float,
        something_there: Callable[[], bool],
    ) -> None:
        self._bit = 1 << options.tool_output
        self._input = None if options.tool_input is None else 1 << (TOOL_INPUT_BIT + options.tool_input)
        self._report = report
        self._set_output = set_output
        self._acts_in_s = acts_in_s
        self._something_there = something_there

    async def close(self) -> bool:
        """Set the output and wait for the gripper."""
        await self._set(self._bit)
        if self._input is None:
            return self._something_there()
        return bool(self._report().digital_inputs & self._input)

    async def open(self) -> None:
        """Clear the output and wait for the gripper."""
        await self._set(0)

    async def _set(self, value: int) -> None:
        self._set_output(self._bit, value)
        deadline_s = time.monotonic() + OUTPUT_TIMEOUT_S
        while (self._report().digital_outputs >> TOOL_OUTPUT_BIT) & self._bit != value:
            if time.monotonic() > deadline_s:
                raise RobotFault.translated(
                    "robot.ur_tool_output",
                    "the tool output of the gripper does not change; check the tool I/O in the "
                    "installation of the controller",
                )
            await asyncio.sleep(CHECK_EVERY_S)
        await asyncio.sleep(self._acts_in_s)


class RobotiqGripper(UrGripper):
    """A gripper of Robotiq, through the socket of its URCap: `SET name value` and `GET name`.

    It is not activated here, because the fingers move then; a person does that at the teach pendant.
    """

    def __init__(self, options: UrOptions) -> None:
        self._address = (options.host, options.robotiq_port)
        self._force = round(options.robotiq_force * _RANGE)
        self._speed = round(options.robotiq_speed * _RANGE)

    async def close(self) -> bool:
        """Close until the fingers meet or an object stops them."""
        return await self._move(_RANGE) == _CLOSED_ON_OBJECT

    async def open(self) -> None:
        """Open completely."""
        await self._move(0)

    async def _move(self, position: int) -> int:
        try:
            async with asyncio.timeout(ANSWER_TIMEOUT_S):
                reader, writer = await asyncio.open_connection(*self._address, limit=1000)
        except (OSError, TimeoutError) as error:
            raise self._silent(str(error) or "no answer") from None
        try:
            return await self._move_with(reader, writer, position)
        except (OSError, TimeoutError, ValueError) as error:
            raise self._silent(str(error) or "no answer") from None
        finally:
            writer.close()

    async def _move_with(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, position: int
    ) -> int:
        async def get(name: str) -> int:
            return _number(name, await _ask(reader, writer, f"GET {name}"))

        if await get("STA") != _ACTIVE:
            raise RobotFault.translated(
                "robot.ur_gripper_not_active",
                "the Robotiq gripper is not activated; activate it at the teach pendant, its fingers "
                "move then",
            )
        wanted = {"POS": position, "SPE": self._speed, "FOR": self._force, "GTO": 1}
        await _set(reader, writer, wanted)
        deadline_s = time.monotonic() + MOVE_TIMEOUT_S
        while await get("PRE") != position or (detected := await get("OBJ")) == _MOVING:
            if time.monotonic() > deadline_s:
                raise ValueError(f"the fingers have not come to rest within {MOVE_TIMEOUT_S:.0f} s")
            await asyncio.sleep(CHECK_EVERY_S)
        fault = await get("FLT")
        if fault:
            raise ValueError(f"fault {fault}")
        return detected

    def _silent(self, reason: str) -> RobotFault:
        return RobotFault.translated(
            "robot.ur_gripper_fault",
            "the Robotiq gripper at {address}: {reason}; check its URCap and its cable",
            address=f"{self._address[0]}:{self._address[1]}",
            reason=reason,
        )


async def _ask(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, request: str) -> str:
    async with asyncio.timeout(ANSWER_TIMEOUT_S):
        writer.write(f"{request}\n".encode())
        return (await reader.readline()).decode(errors="replace").strip()


async def _set(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, values: Mapping[str, int]) -> None:
    answer = await _ask(
        reader, writer, " ".join(["SET", *(f"{name} {value}" for name, value in values.items())])
    )
    if answer != "ack":
        raise ValueError(f'the answer is "{answer[:50]}" instead of "ack"')


def _number(name: str, answer: str) -> int:
    words = answer.split()
    if len(words) != 2 or words[0] != name or not words[1].isdigit():
        raise ValueError(f'the answer to GET {name} is "{answer[:50]}"')
    return int(words[1])
