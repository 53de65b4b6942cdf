"""Simulated devices of every kind: values within their ranges, and commands that take their time.

They use the client that robots use. What a device is comes from its registration, so any registered device
can be simulated.
"""

import math
import random
import struct
import threading
import time
import zlib
from collections.abc import Iterator, Mapping
from typing import Any, Final

from handover_devices.device_client import DeviceClient, Run
from handover_devices.model.description import ROBOTS, CommandKind, DeviceDescription, DeviceKind
from handover_devices.registry.templates import templates

STEP_S: Final = 0.1
COMMAND_S: Final = 2.0
"""How long a command takes."""
STAND_S: Final = 0.3
"""How long a walking robot takes to its stand."""
DRIVEN_PERIOD_S: Final = 0.1
"""Between values while a person drives the device."""
INPUT_PERIOD_S: Final = 0.02
INPUT_CYCLE_S: Final = 6.0
INPUT_HELD_S: Final = 5.0
"""The part of a cycle in which the dead-man control is held; the hand moves in a circle then."""
IMAGE_PERIOD_S: Final = 0.2
IMAGE_WIDTH, IMAGE_HEIGHT = 160, 120
DEFAULT_RANGE: Final = (0.0, 100.0)


class SimulatedDevice:
    """A device that sends its values every `period_s`, in a thread of its own."""

    def __init__(self, client: DeviceClient, description: DeviceDescription, period_s: float = 1.0) -> None:
        self.client = client
        self._values = description.values
        self._joints = [joint.name for joint in description.joints]
        self._positions = dict.fromkeys(self._joints, 0.0)
        self._period_s = period_s
        self._phase = random.uniform(0, 2 * math.pi)  # noqa: S311 - not used for security
        self._moving = threading.Lock()
        self._stopped = threading.Event()
        self._driven = threading.Event()
        self._stand_up: threading.Timer | None = None
        self._driven_s = 0.0
        self._velocities: dict[str, float] = {}
        self._base = (0.0, 0.0, 0.0)
        self._is_input = description.kind is DeviceKind.INPUT_DEVICE
        self._is_camera = description.kind is DeviceKind.CAMERA
        self._walks = description.kind is DeviceKind.HUMANOID
        self.place = [0.0, 0.0, 0.0]
        """Of the base: x and y in m, and its direction in rad."""
        if self._joints or description.kind in ROBOTS:
            client.drive(self._drive)
        for command in description.commands:
            is_motion = command.kind is CommandKind.MOTION
            client.command(command.name)(self._move if is_motion else self._act)

    def start(self) -> None:
        """Connect and send."""
        self.client.start()
        threading.Thread(target=self._send_values, daemon=True).start()
        if self._is_input:
            threading.Thread(target=self._send_inputs, daemon=True).start()
        if self._is_camera:
            threading.Thread(target=self._send_images, daemon=True).start()

    def stop(self) -> None:
        """Disconnect."""
        self._stopped.set()
        self.client.stop()

    def values_at(self, now_s: float) -> dict[str, float]:
        """Return the values at a time: positions of joints, and slow waves within the ranges of sensors."""
        positions = dict(self._positions)
        for number, (name, sensor) in enumerate(self._values.items()):
            if name not in positions:
                low = DEFAULT_RANGE[0] if sensor.minimum is None else sensor.minimum
                high = low + DEFAULT_RANGE[1] if sensor.maximum is None else sensor.maximum
                wave = math.sin(now_s / 30 + self._phase + number)
                positions[name] = round(low + (high - low) * (0.5 + 0.3 * wave), 4)
        return positions

    def _drive(self, motion: Mapping[str, Any] | None) -> None:
        """Follow velocities until the next ones; come to rest without: a walking robot goes to its stand."""
        if not self._moving.acquire(blocking=False):
            return  # a command moves it
        try:
            self._advance(time.monotonic())
            if motion is None:
                self._velocities = {}
                self._base = (0.0, 0.0, 0.0)
            else:
                self._velocities = {
                    name: float(speed)
                    for name, speed in motion.get("joints", {}).items()
                    if name in self._positions
                }
                x, y, turn = motion.get("base", (0.0, 0.0, 0.0))
                self._base = (float(x), float(y), float(turn))
        finally:
            self._moving.release()
        if motion is not None:
            if self._stand_up is not None:
                self._stand_up.cancel()
                self._stand_up = None
            if not self._driven.is_set():
                self._driven.set()
                self.client.state("busy")
            return
        self._driven.clear()
        self._stand_up = threading.Timer(STAND_S if self._walks else 0.0, self._rest)
        self._stand_up.daemon = True
        self._stand_up.start()

    def _rest(self) -> None:
        self.client.state("idle")
        self.client.rests({"posture": "Stand"} if self._walks else {})

    def _advance(self, now_s: float) -> None:
        """Move on to a time with the velocities since the last one."""
        passed_s, self._driven_s = min(now_s - self._driven_s, 2 * DRIVEN_PERIOD_S), now_s
        for name, speed in self._velocities.items():
            limits = self._values[name]
            position = self._positions[name] + speed * passed_s
            low = -math.inf if limits.minimum is None else limits.minimum
            high = math.inf if limits.maximum is None else limits.maximum
            self._positions[name] = min(max(position, low), high)
        x, y, turn = self._base
        c, s = math.cos(self.place[2]), math.sin(self.place[2])
        self.place[0] += (c * x - s * y) * passed_s
        self.place[1] += (s * x + c * y) * passed_s
        self.place[2] += turn * passed_s

    def _send_values(self) -> None:
        self.client.state("idle", 0.9)
        while not self._stopped.is_set():
            self._driven.wait(self._period_s)
            if self._stopped.wait(DRIVEN_PERIOD_S if self._driven.is_set() else 0.0):
                return
            now_s = time.time()
            values = self.values_at(now_s)
            if values:
                self.client.send(values, now_s)

    def _send_inputs(self) -> None:
        begun_s = time.monotonic()
        while not self._stopped.wait(INPUT_PERIOD_S):
            axes, held = input_at(time.monotonic() - begun_s)
            self.client.human_input(axes, held)

    def _send_images(self) -> None:
        begun_s = time.monotonic()
        while not self._stopped.wait(IMAGE_PERIOD_S):
            self.client.image(image_at(time.monotonic() - begun_s))

    def _move(self, parameters: Mapping[str, Any], run: Run) -> dict[str, Any]:
        if not self._moving.acquire(blocking=False):
            raise RuntimeError("the device is moving already")
        try:
            self.client.state("busy")
            begin, target = dict(self._positions), self._target(parameters)
            for fraction in _fractions(run):
                for name, position in target.items():
                    self._positions[name] = begin[name] + (position - begin[name]) * fraction
            return {"joints": dict(self._positions)} if self._joints else {}
        finally:
            self._moving.release()
            self.client.state("idle")

    def _target(self, parameters: Mapping[str, Any]) -> dict[str, float]:
        """Return the positions that a motion asks for, within the limits of the joints."""
        joints = parameters.get("joints", [0.0] * len(self._joints))
        named = joints if isinstance(joints, Mapping) else dict(zip(self._joints, joints, strict=False))
        target: dict[str, float] = {}
        for name, position in named.items():
            if name not in self._positions:
                raise ValueError(f'there is no joint "{name}"; there are {", ".join(self._joints)}')
            limits = self._values[name]
            low = -math.inf if limits.minimum is None else limits.minimum
            high = math.inf if limits.maximum is None else limits.maximum
            if not low <= float(position) <= high:
                raise ValueError(f"{name}: {position} is not within {low:g} and {high:g}")
            target[name] = float(position)
        return target

    @staticmethod
    def _act(_: Mapping[str, Any], run: Run) -> dict[str, Any]:
        for _fraction in _fractions(run):
            pass
        return {}


def input_at(passed_s: float) -> tuple[dict[str, float], bool]:
    """Return the axes of a simulated stylus, from -1 to 1, and whether the dead-man control is held."""
    in_cycle_s = passed_s % INPUT_CYCLE_S
    if in_cycle_s >= INPUT_HELD_S:
        return {"stickX": 0.0, "stickY": 0.0, "stickZ": 0.0}, False
    angle = 2 * math.pi * in_cycle_s / INPUT_HELD_S
    return {"stickX": math.sin(angle), "stickY": math.cos(angle), "stickZ": 0.3 * math.sin(2 * angle)}, True


def image_at(passed_s: float) -> bytes:
    """Return the image of a simulated camera, a PNG: a bright bar that crosses a grey scene in 4 s."""
    bar = int(passed_s / 4 % 1 * IMAGE_WIDTH)
    scene = bytes(235 if abs(x - bar) < 6 else 60 + x // 4 for x in range(IMAGE_WIDTH))
    rows = b"".join(b"\0" + scene for _ in range(IMAGE_HEIGHT))
    header = struct.pack(">IIBBBBB", IMAGE_WIDTH, IMAGE_HEIGHT, 8, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def _fractions(run: Run) -> Iterator[float]:
    """Yield growing fractions until 1 during `COMMAND_S`, and report them; end when cancelled."""
    steps = round(COMMAND_S / STEP_S)
    for step in range(1, steps + 1):
        if run.cancelled.wait(STEP_S):
            return
        run.progress(step / steps)
        yield step / steps


def _words(kind: DeviceKind) -> str:
    """Return a kind as words: `inputDevice` is "input device"."""
    return "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in kind)


def examples() -> dict[str, DeviceDescription]:
    """Return a simulated device of each kind, by name, and one of each template."""

    def described(kind: DeviceKind, **members: Any) -> DeviceDescription:
        return DeviceDescription.model_validate(
            {"kind": kind, "title": f"Simulated {_words(kind)}", **members}
        )

    stop = {"name": "stop", "kind": "action"}
    devices = {f"sim-{name}": template for name, template in templates().items()}
    devices["sim-sensor"] = described(
        DeviceKind.SENSOR,
        sensors=[
            {"name": "temperature", "unit": "CEL", "minimum": -20, "maximum": 60, "deadBand": 0.2},
            {"name": "humidity", "unit": "P1", "minimum": 0, "maximum": 100, "deadBand": 1},
        ],
        commands=[{"name": "setInterval", "kind": "setting"}],
    )
    devices["sim-mobile-robot"] = described(
        DeviceKind.MOBILE_ROBOT,
        sensors=[
            {"name": "x", "unit": "MTR", "deadBand": 0.05},
            {"name": "y", "unit": "MTR", "deadBand": 0.05},
            {"name": "speed", "unit": "MTS", "minimum": 0, "maximum": 1.5, "deadBand": 0.05},
        ],
        commands=[{"name": "driveTo", "kind": "motion"}, stop],
    )
    devices["sim-gripper"] = described(
        DeviceKind.GRIPPER,
        joints=[{"name": "finger", "type": "prismatic", "lower": 0, "upper": 0.04}],
        gripper={"maxWidth": 0.08},
        commands=[{"name": "grip", "kind": "motion"}],
    )
    devices["sim-actuator"] = described(
        DeviceKind.ACTUATOR,
        sensors=[{"name": "opening", "unit": "P1", "minimum": 0, "maximum": 100, "deadBand": 1}],
        commands=[{"name": "open", "kind": "action"}, {"name": "close", "kind": "action"}],
    )
    devices["sim-wearable"] = described(
        DeviceKind.WEARABLE, sensors=[{"name": "steps", "minimum": 0, "maximum": 20000, "deadBand": 10}]
    )
    devices["sim-camera"] = described(
        DeviceKind.CAMERA,
        sensors=[{"name": "framesPerSecond", "unit": "HTZ", "minimum": 0, "maximum": 60, "deadBand": 1}],
        commands=[{"name": "takePicture", "kind": "action"}],
    )
    devices["sim-stylus"] = described(DeviceKind.INPUT_DEVICE)
    devices["sim-other"] = described(DeviceKind.OTHER, sensors=[{"name": "level", "unit": "LTR"}])
    return devices
