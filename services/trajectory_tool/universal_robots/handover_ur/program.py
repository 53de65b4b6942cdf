"""The URScript program that runs on the controller while the tool moves the arm.

Each cycle it reads a heartbeat, a mode and a joint position from RTDE input registers. In mode SERVO it calls
`servoj`, otherwise it stops the joints and waits. In a cycle without a new heartbeat it continues the last
step of the target, a little shorter each time, so that late packages cause no jerk. Two watchdogs stop the
arm without the tool:

- the program counts cycles without a new heartbeat, stops the joints with `stopj` and ends;
- `rtde_set_watchdog` ends the program when the registers are not written at all.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from handover_ur.states import (
    HEARTBEAT_REGISTER,
    MODE_REGISTER,
    PROGRAM_ID_REGISTER,
    PROGRAM_STATE_REGISTER,
    TARGET_REGISTER,
    ExchangeMode,
    ProgramState,
)

JOINTS = 6
STEP_DECAY = 0.97
"""A step without a heartbeat is so much shorter than the one before."""


@dataclass(frozen=True, slots=True)
class Payload:
    """Mass at the flange in kg and its centre of gravity in m, in the frame of the flange."""

    mass_kg: float
    centre_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ProgramParameters:
    """What the program depends on; `program_id` identifies this run of it."""

    program_id: int
    cycle_s: float
    watchdog_s: float
    stop_rad_s2: float
    lookahead_s: float
    gain: float
    payload: Payload | None = None


def program(parameters: ProgramParameters) -> str:
    """Return the text of the program, for the script interface of the controller."""
    missed = max(round(parameters.watchdog_s / parameters.cycle_s), 2)
    min_hz = 1.0 / (3 * parameters.watchdog_s)
    received = _list(f"read_input_float_register({TARGET_REGISTER + n})" for n in range(JOINTS))
    zeros = _list("0.0" for _ in range(JOINTS))
    difference = _list(f"received_target[{n}] - target[{n}]" for n in range(JOINTS))
    shorter = _list(f"{STEP_DECAY} * step[{n}]" for n in range(JOINTS))
    continued = _list(f"target[{n}] + step[{n}]" for n in range(JOINTS))
    stop = f"stopj({parameters.stop_rad_s2:.3f})"
    servo = (
        f"servoj(target, 0, 0, {parameters.cycle_s:.6f}, {parameters.lookahead_s:.3f}, {parameters.gain:.0f})"
    )
    lines = [
        "def handover_servo():",
        f'  rtde_set_watchdog("input_int_register_{HEARTBEAT_REGISTER}", {min_hz:.3f}, "stop")',
        *_payload_lines(parameters.payload),
        f"  write_output_integer_register({PROGRAM_ID_REGISTER}, {parameters.program_id})",
        f"  write_output_integer_register({PROGRAM_STATE_REGISTER}, {ProgramState.READY:d})",
        f"  heartbeat = read_input_integer_register({HEARTBEAT_REGISTER})",
        "  missed = 0",
        "  moving = False",
        f"  mode = {ExchangeMode.HOLD:d}",
        f"  while mode != {ExchangeMode.END:d} and missed < {missed}:",
        f"    received = read_input_integer_register({HEARTBEAT_REGISTER})",
        "    if received == heartbeat:",
        "      missed = missed + 1",
        "    else:",
        "      missed = 0",
        "      heartbeat = received",
        "    end",
        f"    mode = read_input_integer_register({MODE_REGISTER})",
        f"    if mode == {ExchangeMode.SERVO:d}:",
        "      if moving and missed > 0:",
        f"        step = {shorter}",
        f"        target = {continued}",
        "      else:",
        f"        received_target = {received}",
        "        if moving:",
        f"          step = {difference}",
        "        else:",
        f"          step = {zeros}",
        "        end",
        "        target = received_target",
        "      end",
        "      if not moving:",
        f"        write_output_integer_register({PROGRAM_STATE_REGISTER}, {ProgramState.SERVOING:d})",
        "        moving = True",
        "      end",
        f"      {servo}",
        "    else:",
        "      if moving:",
        f"        {stop}",
        f"        write_output_integer_register({PROGRAM_STATE_REGISTER}, {ProgramState.READY:d})",
        "        moving = False",
        "      end",
        "      sync()",
        "    end",
        "  end",
        f"  {stop}",
        f"  if missed >= {missed}:",
        f"    write_output_integer_register({PROGRAM_STATE_REGISTER}, {ProgramState.ENDED_BY_WATCHDOG:d})",
        "  else:",
        f"    write_output_integer_register({PROGRAM_STATE_REGISTER}, {ProgramState.ABSENT:d})",
        "  end",
        "end",
    ]
    return "\n".join(lines) + "\n"


def _list(elements: Iterable[str]) -> str:
    return f"[{', '.join(elements)}]"


def _payload_lines(payload: Payload | None) -> Sequence[str]:
    if payload is None:
        return ()
    x, y, z = payload.centre_m
    return (f"  set_payload({payload.mass_kg:.4f}, [{x:.5f}, {y:.5f}, {z:.5f}])",)
