"""A simulated controller for dry runs; lines of input are what a person does at the arm.

The lines: `power-on`, `brakes`, `emergency-stop`, `protective-stop`, `safeguard`, `safeguard-end`, `clear`,
`slider 0.3`, `local`, `remote`, `push 0.1 0 0 0 0 0`, `force 0 0 60`, `drop`, `delay 0.05`, `restart 2`,
`state`.
"""

import asyncio
import sys
from collections.abc import Callable

from handover_ur.simulator.controller import SimulatedController
from handover_ur.simulator.simulator import Ports, Simulator


async def run(
    controller: SimulatedController, host: str, ports: Ports, answer: Callable[[str], None]
) -> None:
    """Serve a controller until cancelled; `answer` gets a text for each line of standard input."""
    async with Simulator(controller, host, ports) as simulator:
        answer(
            f"simulated controller on {host}: RTDE {ports.rtde}, dashboard {ports.dashboard}, "
            f"script {ports.script}, Robotiq {ports.robotiq}"
        )
        reader = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(reader), sys.stdin
        )
        while line := await reader.readline():
            answer(await _do(simulator, line.decode(errors="replace").split()))
        await asyncio.Event().wait()


async def _do(simulator: Simulator, words: list[str]) -> str:
    controller = simulator.controller
    actions = {
        "power-on": controller.power_on,
        "power-off": controller.power_off,
        "brakes": controller.release_brakes,
        "emergency-stop": controller.emergency_stop,
        "safeguard": controller.safeguard_stop,
        "safeguard-end": controller.release_safeguard,
        "clear": controller.clear_stop,
        "drop": simulator.rtde.drop_clients,
    }
    try:
        match words:
            case [word] if word in actions:
                actions[word]()
            case ["protective-stop"]:
                controller.protective_stop("requested at the pendant")
            case ["slider", value]:
                controller.speed_slider = min(max(float(value), 0.0), 1.0)
            case ["local" | "remote" as control]:
                controller.in_remote_control = control == "remote"
            case ["push", *values] if len(values) == 6:
                controller.move_by_hand(tuple(map(float, values)))
            case ["force", x, y, z]:
                controller.tcp_force_n = (float(x), float(y), float(z))
            case ["delay", value]:
                simulator.rtde.output_delay_s = max(float(value), 0.0)
            case ["restart", value]:
                await simulator.restart(float(value))
            case ["state"] | []:
                pass
            case _:
                others = "protective-stop, slider, local, remote, push, force, delay, restart, state"
                return f"unknown; known: {', '.join(actions)}, {others}"
    except ValueError as error:
        return str(error)
    positions = " ".join(f"{value:.4f}" for value in controller.positions)
    messages = controller.messages[-1:] or ["-"]
    return f"{controller.robot_mode.name} {controller.safety.name} {positions} | {messages[0]}"
