"""The control cycle is a process of its own: what commands it may be killed, and the robot stands."""

import ctypes
import gc
import os
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from handover.errors import UsageError
from handover_humanoid.behaviours.component_state import Behaviour
from handover_humanoid.behaviours.humanoid_component import HumanoidComponent
from handover_humanoid.components.robot import JointCommand, RobotSensors
from handover_humanoid.control_process import control_loop
from handover_humanoid.cycle.deployment import Deployment, read_deployment
from handover_humanoid.cycle.loop import MAX_FAULTS, Mode
from handover_humanoid.cycle.ports import PortReader, PortWriter
from handover_humanoid.cycle.wish import WISH
from handover_humanoid.patterns.regions import SIDES
from services.whole_body_control.tests.unit.running_cycle import Cycle
from tests.kit.waiting import Bound, scaled

DEPLOYMENT = """
folder: {folder}
paced: false
fifo: false
components:
  robot: {{kind: mujoco, realtime: true}}
  walking: {{kind: walking, solver: daqp, realtime: true}}
  page: {{kind: page, realtime: false}}
"""
COMMANDER = """
import sys, time
from pathlib import Path
import numpy as np
from handover_humanoid.cycle.wish import WISH
from handover_humanoid.cycle.ports import PortWriter
port = PortWriter(Path(sys.argv[1]) / "wish", WISH)
wish = {"ahead_mps": 0.05, "speed_share": 1.0}
while True:
    port.write(np.array([wish.get(name, 0.0) for name in WISH]))
    time.sleep(0.02)
"""
BOUND_S = 120.0
MEMORY_BYTES, OBJECTS = 4096, 20
"""What 600 cycles may keep: records of the plan differ with the phase of a step."""
HEAP_PARTS, HEAP_PART_S = 6, 1.0
HEAP_BYTES = 16
"""The smallest that an allocation takes: fewer in each period are none in some."""
PARTS, LAST = 10, 5
"""Of the parts, of which the first ones fill what the cycle keeps, such as the hulls of footprints."""


def written(folder: Path, text: str = DEPLOYMENT) -> Path:
    file = folder / "deployment.yaml"
    file.write_text(text.format(folder=folder / "ports"), encoding="utf-8")
    return file


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    bound = Bound(BOUND_S)
    while not condition():
        assert process.poll() is None, f"the process ended with {process.returncode}"
        bound.check("the condition never came true")
        time.sleep(0.01)


@pytest.fixture(params=["stack", "projections"])
def cycle(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Return a control process with each motion engine, which is stopped in the end."""
    module = "handover_humanoid.control_process"
    text = DEPLOYMENT.replace("solver: daqp", f"engine: {request.param}")
    with subprocess.Popen([sys.executable, "-m", module, str(written(tmp_path, text))], text=True) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.nightly
def test_the_cycle_outlives_the_process_that_commands_it(
    cycle: subprocess.Popen[str], tmp_path: Path
) -> None:
    folder = tmp_path / "ports"
    wait_for((folder / "state").exists, cycle)
    wait_for((folder / "wish").exists, cycle)
    state: PortReader | None = None

    def value(name: str) -> float:
        nonlocal state
        try:
            state = state or PortReader(folder / "state")
        except UsageError:  # it is just being made
            return float("nan")
        return state.value(name) if state.read() else float("nan")

    wait_for(lambda: value("cycles") > 10, cycle)
    assert value("mode") == Mode.STANDING
    with subprocess.Popen([sys.executable, "-c", COMMANDER, str(folder)], text=True) as commander:
        try:
            wait_for(lambda: value("phase") == 2.0, cycle)
        finally:
            os.kill(commander.pid, signal.SIGKILL)
    killed_at = value("cycles")
    wait_for(lambda: value("mode") == Mode.STANDING, cycle)
    wait_for(lambda: value("phase") == 0.0, cycle)
    wait_for(lambda: value("cycles") > killed_at + 100, cycle)
    assert value("base.z") > 0.4
    assert abs(value("com.x") - value("reference.x")) < 0.02
    cycle.send_signal(signal.SIGTERM)
    assert cycle.wait(scaled(BOUND_S)) == 0


def test_a_controller_without_valid_values_is_stopped_and_the_joints_hold(tmp_path: Path) -> None:
    deployment = read_deployment(written(tmp_path))
    loop, state = control_loop(deployment)
    periods = round(loop.controller.control_s / loop.robot.period_s)
    assert periods > 1  # the joints get a command in each cycle, the stack runs in some
    wish = PortWriter(deployment.folder / "wish", WISH)
    modes = []
    for values in (np.full(len(WISH), np.nan), np.zeros(len(WISH))):  # a wish that is not finite is none
        wish.write(values)
        for _ in range(periods):
            loop.cycle()
        modes.append(loop.mode)
    assert modes == [Mode.STANDING, Mode.FOLLOWING]

    class Broken(HumanoidComponent):
        def step(self, sensors: RobotSensors, command: JointCommand) -> str:
            sensors.gyroscope[0] = np.nan
            return super().step(sensors, command)

    loop.controller = Broken(loop.robot.humanoid, None, loop.robot)
    for _ in range(MAX_FAULTS * periods - periods):
        loop.cycle()
        assert loop.mode is not Mode.HOLDING
    for _ in range(50 * periods):
        loop.cycle()
    assert "not finite" in loop.fault
    assert state.read()
    assert state.value("mode") == Mode.HOLDING
    assert loop.robot.true_configuration()[2] > 0.4


def traced_bytes() -> int:
    """Return how much the cycle has allocated; other threads of the test run allocate meanwhile."""
    ours = [tracemalloc.Filter(True, f"*/{name}/*") for name in ("services", "handover", "numpy")]
    return sum(trace.size for trace in tracemalloc.take_snapshot().filter_traces(ours).traces)


@pytest.mark.nightly
def test_the_cycle_keeps_no_memory_and_leaves_nothing_to_collect(tmp_path: Path) -> None:
    """Equal parts of a walk: what the cycle keeps shows in each part, what another thread keeps does not."""
    deployment = read_deployment(written(tmp_path))
    loop, _ = control_loop(deployment)
    wish, held, objects = PortWriter(deployment.folder / "wish", WISH), [], []
    wanted = {"ahead_mps": 0.05, "speed_share": 1.0}
    gc.collect()
    gc.disable()
    tracemalloc.start()
    try:
        for _part in range(PARTS):
            for _ in range(600):
                wish.write(np.array([wanted.get(name, 0.0) for name in WISH]))
                loop.cycle()
            objects.append(len(gc.get_objects()))
            held.append(traced_bytes())
    finally:
        tracemalloc.stop()
        gc.enable()
    assert loop.mode is Mode.FOLLOWING
    assert held[-1] > 0
    assert min(np.diff(held[-LAST:])) < MEMORY_BYTES, held
    assert min(np.diff(objects[-LAST:])) < OBJECTS, objects


class _HeapFigures(ctypes.Structure):
    """The result of `mallinfo2` of glibc."""

    _fields_ = [(f"figure_{number}", ctypes.c_size_t) for number in range(10)]


def heap_bytes() -> int:
    """Return what native code and NumPy have allocated, which `tracemalloc` does not know."""
    library = ctypes.CDLL(None)
    library.mallinfo2.restype = _HeapFigures
    figures = library.mallinfo2()
    return int(figures.figure_7 + figures.figure_4)  # in the heap, and mapped


@pytest.mark.nightly
@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallinfo2"), reason="only glibc counts memory")
@pytest.mark.parametrize("behaviour", [None, *Behaviour])
def test_no_behaviour_keeps_memory_of_native_code(tmp_path: Path, behaviour: Behaviour | None) -> None:
    """What each period keeps shows in each part; what another thread, or a new step, allocates does not."""
    cycle = Cycle(tmp_path)
    wish: dict[str, float] = {}
    if behaviour is not None:
        wish = {"behaviour": float(behaviour), "speed_share": 1.0, "ahead_mps": 0.05}
    led = None
    if behaviour is Behaviour.ASSISTED_WALKING:
        pulls = {"held": 2.0, "force_x_n": 3.0}
        led = {f"{side}.{name}": value for side in SIDES for name, value in pulls.items()}
    gc.collect()
    gc.disable()
    try:
        state = cycle.run(3.0, wish, led)
        kept = []
        for _ in range(HEAP_PARTS):
            before = heap_bytes()
            state = cycle.run(HEAP_PART_S, wish, led)
            kept.append(heap_bytes() - before)
    finally:
        gc.enable()
    assert state["behaviour"] == (behaviour or 0.0)
    assert state["mode"] == Mode.FOLLOWING
    periods = HEAP_PART_S / cycle.loop.controller.control_s
    assert min(kept) < periods * HEAP_BYTES, kept


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("kind: page, realtime: false", "kind: page, realtime: true", '"page" .* set realtime: false'),
        ("solver: daqp, realtime: true", "solver: daqp, realtime: false", '"walking" .* set realtime: true'),
        ("kind: mujoco", "kind: page", "0 robots"),
        ("paced: false", "speed: 3", "speed"),
        ("solver: daqp", "solver: magic", "solver"),
    ],
)
def test_a_deployment_that_cannot_work_is_explained(
    tmp_path: Path, before: str, after: str, says: str
) -> None:
    with pytest.raises(UsageError, match=f"deployment.yaml: (.|\n)*{says}"):
        read_deployment(written(tmp_path, DEPLOYMENT.replace(before, after)))


def test_a_deployment_is_read(tmp_path: Path) -> None:
    deployment: Deployment = read_deployment(written(tmp_path))
    assert deployment.robot.humanoid == "coman"
    assert [name for name, component in deployment.components.items() if not component.realtime] == ["page"]
