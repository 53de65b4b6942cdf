"""`python -m services.trajectory_tool.universal_robots.simulator`: a simulated controller for dry runs.

Lines on standard input are what a person does at the arm: `power-on`, `brakes`, `emergency-stop`,
`protective-stop`, `safeguard`, `safeguard-end`, `clear`, `slider 0.3`, `local`, `remote`,
`push 0.1 0 0 0 0 0`, `drop`, `delay 0.05`, `restart 2`, `state`.
"""

import argparse
import asyncio
import sys

from services.trajectory_tool.universal_robots.simulator.controller import SimulatedController
from services.trajectory_tool.universal_robots.simulator.simulator import Ports, Simulator

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--host", default="127.0.0.1", help="the address to listen on")
    for name, port in (("rtde", 30004), ("dashboard", 29999), ("script", 30002), ("robotiq", 63352)):
        parser.add_argument(f"--{name}-port", type=int, default=port)
    parser.add_argument("--off", action="store_true", help="begin with the arm powered off")
    parser.add_argument("--joints", type=float, nargs=6, default=HOME, help="joint positions in rad")
    return parser.parse_args()


async def _run(arguments: argparse.Namespace) -> None:
    ports = Ports(
        arguments.rtde_port, arguments.dashboard_port, arguments.script_port, arguments.robotiq_port
    )
    controller = SimulatedController(tuple(arguments.joints), running=not arguments.off)
    async with Simulator(controller, arguments.host, ports) as simulator:
        print(f"simulated controller on {arguments.host}: {ports}", flush=True)  # noqa: T201
        reader = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(reader), sys.stdin
        )
        while line := await reader.readline():
            print(await _do(simulator, line.decode().split()), flush=True)  # noqa: T201
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
            case ["delay", value]:
                simulator.rtde.output_delay_s = max(float(value), 0.0)
            case ["restart", value]:
                await simulator.restart(float(value))
            case ["state"] | []:
                pass
            case _:
                return (
                    f"unknown; known: {', '.join([*actions, 'protective-stop', 'slider', 'push', 'state'])}"
                )
    except ValueError as error:
        return str(error)
    positions = " ".join(f"{value:.4f}" for value in controller.positions)
    messages = controller.messages[-1:] or ["-"]
    return f"{controller.robot_mode.name} {controller.safety.name} {positions} | {messages[0]}"


if __name__ == "__main__":
    asyncio.run(_run(_arguments()))
