"""The robot in simulated physics as a driver, and the real tool with it."""

import asyncio
import math
import threading
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from handover.errors import UsageError
from handover.performer import TaskFailed
from handover_robots.physics import is_available
from handover_robots.planning import is_available as is_planning_available
from handover_robots.tasks import operations, parameters

if not (is_available() and is_planning_available()):
    pytest.skip("the extra physics is not installed", allow_module_level=True)

from handover_robots.cell.cell import RobotCell
from handover_robots.driver_base.context import Clock
from handover_robots.driver_base.robot import Robot
from handover_robots.driver_contract import RobotContract
from handover_robots.drivers.simulated_robot import SimulatedRobot
from handover_robots.limits.limiter import JointLimiter
from handover_robots.model.faults import RobotFault
from handover_robots.model.joints import Joints
from handover_robots.model.poses import NO_TURN, Frame, Pose
from handover_robots.model.robot_model import RobotModel
from handover_robots.physics.pacing import PacedSimulation
from handover_robots.physics.parts import Parts
from handover_robots.physics.robot import PhysicsRobot
from handover_robots.physics.shared_world import SharedWorld
from handover_robots.physics.simulation import Simulation
from handover_robots.physics.world_model import build
from handover_robots.robots import panda, ur10
from handover_robots.robots.ur10 import ROBOT
from handover_robots.routes.scenes import scene_view
from handover_robots.scene.reading import load
from handover_robots.scene.scene import Scene
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks.work import Work

NAME = "ur10-1"
NEAR = (ROBOT.home[0] + 0.1, *ROBOT.home[1:])


def a_world(pace: float | None, *, scene: Scene | None = None, **models: RobotModel) -> SharedWorld:
    """Return a world, by default with one arm and without bins."""
    robots, scene = models or {NAME: ROBOT}, scene or Scene(name="empty")
    world = build(robots, scene, Parts.needed(scene))
    simulation = Simulation(world, {name: model.home for name, model in robots.items()})
    return SharedWorld(PacedSimulation(simulation, pace), robots, scene, Parts(simulation, scene, 174))


class TestPhysicsRobot(RobotContract):
    home = ROBOT.home
    limits = ROBOT.limits

    @pytest.fixture
    async def robot(self) -> AsyncIterator[PhysicsRobot]:
        async with PhysicsRobot(a_world(1.0), NAME, ROBOT, self.limits) as made:
            yield made

    @pytest.fixture
    def move_by_hand(self, robot: PhysicsRobot) -> Callable[[Joints], None]:
        def move(displacements: Joints) -> None:
            there = tuple(map(sum, zip(robot.arm.positions, displacements, strict=True)))
            robot.simulation.place_arm(NAME, there)

        return move


async def path_of(robot: Robot, target: Joints, now_s: Callable[[], float]) -> dict[int, Pose]:
    """Return where the tool is in each cycle of 2 ms of a motion."""
    start_s, path = now_s(), {}

    def record() -> float:
        path[round((now_s() - start_s) * 500)] = ROBOT.tool_pose(robot.state().positions)
        return 1.0

    assert await robot.move(target, 1.0, record)
    return path


async def test_both_simulated_robots_make_the_same_motion_within_a_millimetre() -> None:
    world = a_world(None)
    simulation = world.simulation
    time_s = [simulation.time_s]

    def wait(seconds: float) -> None:
        time_s[0] += seconds

    clock = Clock(lambda: time_s[0], wait)
    target = tuple(
        here + turn for here, turn in zip(ROBOT.home, (0.5, 0.2, -0.2, 0.1, 0.3, 0.5), strict=True)
    )
    async with (
        PhysicsRobot(world, NAME, ROBOT, ROBOT.limits) as physical,
        SimulatedRobot(
            ROBOT.home, ROBOT.limits, something_there=lambda _: False, control_hz=500, clock=clock
        ) as kinematic,
    ):
        paths = [
            await path_of(physical, target, lambda: simulation.time_s),
            await path_of(kinematic, target, lambda: time_s[0]),
        ]
    common = paths[0].keys() & paths[1].keys()
    assert len(common) > 100
    # The kinematic robot reports the setpoint of the cycle before.
    assert max(paths[0][step].distance_m(paths[1][min(step + 1, max(common))]) for step in common) < 0.001
    assert abs(max(paths[0]) - max(paths[1])) <= 1


class Freely:
    def may_go(self) -> bool:
        return True

    async def rest(self) -> None:
        raise AssertionError("nobody asked for rest")


class PhysicsCell:
    """A cell with physics as fast as possible, and operations in it."""

    def __init__(self, folder: Path, **others: Any) -> None:
        settings = TrajectorySettings(
            data_dir=folder, robot="physics", simulation_pace=0, robot_speed=1.0, **others
        )
        self.cell = RobotCell(settings)
        self.unit = next(iter(self.cell.units.values()))
        robot = self.unit.robot
        assert isinstance(robot, PhysicsRobot)
        self.robot = robot
        self.parts: Parts = robot.world.parts
        self._tasks = 0

    async def do(self, operation: str, *, robot: str = "", **asked: Any) -> dict[str, Any]:
        self._tasks += 1
        performed = operations.operation_named(operation)
        read = parameters.read(performed.parameters, operation, asked)
        unit = self.cell.units[robot] if robot else self.unit
        return await performed.perform(Work(f"task-{self._tasks}", operation, unit, Freely(), 1.0), read)


@pytest.fixture
async def physics(tmp_path: Path) -> AsyncIterator[PhysicsCell]:
    made = PhysicsCell(tmp_path)
    async with made.cell:
        yield made


@pytest.mark.nightly
async def test_a_part_is_found_by_the_camera_picked_and_lies_in_the_nest(physics: PhysicsCell) -> None:
    before = len(physics.parts.in_bin("bin-1"))
    seen = await physics.do("scan", bin="bin-1")
    assert seen["found"]
    picked = await physics.do("pick", part=seen["part"], pose=seen["pose"])
    assert picked == {"part": seen["part"], "gripped": True}
    assert physics.robot.is_holding
    held = physics.robot.simulation.gripped_part(NAME)
    await physics.do("place", location="fixture-1")
    assert not physics.robot.is_holding
    assert physics.parts.in_fixture("fixture-1") == [held]
    assert len(physics.parts.in_bin("bin-1")) == before - 1


@pytest.mark.nightly
async def test_a_part_that_a_person_holds_out_is_gripped_and_placed(physics: PhysicsCell) -> None:
    async def confirm(work: Work) -> None:
        while not work.confirm():
            await asyncio.sleep(0.01)

    async def take() -> dict[str, Any]:
        wanted = {"direction": "take", "part": "housing", "pose": {"position": [-0.7, 0.3, 0.55]}}
        operation = operations.operation_named("handOver")
        read = parameters.read(operation.parameters, "handOver", wanted)
        work = Work("task-take", "handOver", physics.unit, Freely(), 1.0)
        done, _ = await asyncio.gather(operation.perform(work, read), confirm(work))
        return done

    await take()
    held = physics.robot.simulation.gripped_part(NAME)
    assert held is not None
    assert not physics.robot.simulation.is_parked(held), "it has its weight"
    assert (await physics.do("place", location="fixture-1"))["part"] == "housing"
    assert physics.parts.in_fixture("fixture-1") == [held]
    for part in range(len(physics.robot.simulation.world.parts)):
        physics.robot.simulation.set_friction(part, 0.001)
    with pytest.raises(TaskFailed, match="nothing was between the fingers"):
        await take()
    assert not physics.robot.gripper_closed


@pytest.mark.nightly
async def test_a_panda_with_seven_joints_and_its_own_gripper_picks_and_places(tmp_path: Path) -> None:
    physics = PhysicsCell(tmp_path, robot_model="panda", scan_seed=174)
    async with physics.cell:
        for count in (1, 2):
            seen = await physics.do("scan", bin="bin-1")
            await physics.do("pick", part=seen["part"], pose=seen["pose"])
            await physics.do("place", location="fixture-1")
            assert len(physics.parts.in_fixture("fixture-1")) == count


async def test_a_part_that_slips_out_of_the_gripper_fails_the_task_with_a_reason(
    physics: PhysicsCell,
) -> None:
    seen = await physics.do("scan", bin="bin-1")
    for part in physics.parts.in_bin("bin-1"):
        physics.robot.simulation.set_friction(part, 0.001)
    with pytest.raises(Exception, match=r"slipped|no part at"):
        await physics.do("pick", part=seen["part"], pose=seen["pose"])
    assert physics.unit.held is None
    assert not physics.robot.gripper_closed


@pytest.mark.nightly
async def test_parts_and_a_held_part_are_found_again_after_a_restart(tmp_path: Path) -> None:
    first = PhysicsCell(tmp_path)
    async with first.cell:
        seen = await first.do("scan", bin="bin-1")
        await first.do("pick", part=seen["part"], pose=seen["pose"])
        lying = [first.robot.simulation.part_pose(part) for part in first.parts.in_bin("bin-1")]
    second = PhysicsCell(tmp_path)
    async with second.cell:
        assert second.robot.is_holding
        assert second.unit.held == seen["part"]
        poses = [second.robot.simulation.part_pose(part) for part in second.parts.in_bin("bin-1")]
        assert max(pose.distance_m(other) for pose, other in zip(poses, lying, strict=True)) < 1e-4
        placed = await second.do("place", location="fixture-1")
        assert placed["part"] == seen["part"]


@pytest.mark.nightly
async def test_a_part_is_put_into_a_fixture_that_was_moved_while_the_robot_held_it(tmp_path: Path) -> None:
    first = PhysicsCell(tmp_path)
    async with first.cell:
        seen = await first.do("scan", bin="bin-1")
        await first.do("pick", part=seen["part"], pose=seen["pose"])
        time_s, lying = first.robot.simulation.time_s, first.parts.in_bin("bin-1")
        before = [first.robot.simulation.part_pose(part) for part in lying]
        scene = first.cell.scene.model_dump(mode="json")
        fixture = scene["fixtures"]["fixture-1"]
        for spot in (fixture["body"], *fixture["nests"]):
            spot["position"][0] += 0.06
        await first.cell.change_scene(scene)
        assert first.robot.simulation.time_s == time_s
        assert first.robot.is_holding
        after = [first.robot.simulation.part_pose(part) for part in lying]
        assert max(pose.distance_m(other) for pose, other in zip(before, after, strict=True)) < 1e-9
        placed = await first.do("place", location="fixture-1")
        assert placed["pose"]["position"][0] > -0.56
        (part,) = first.parts.in_fixture("fixture-1")
        assert first.robot.simulation.part_pose(part).position[2] > 0.036, "it lies on the fixture"
    second = PhysicsCell(tmp_path)
    assert second.parts.in_fixture("fixture-1") == [part]


async def test_a_scene_that_cannot_be_simulated_is_refused_and_changes_nothing(physics: PhysicsCell) -> None:
    scene = physics.cell.scene.model_dump(mode="json")
    scene["bins"]["bin-1"]["walls"] = None
    with pytest.raises(UsageError, match="has no walls"):
        await physics.cell.change_scene(scene)
    assert physics.cell.revision == 0


BALLS = {"ball-1": (0.6, -0.5, 0.1), "ball-2": (0.5, -0.25, 0.3), "ball-3": (0.25, -0.4, 0.2)}


async def test_a_fixed_camera_is_calibrated_by_balls_while_the_robot_rests(tmp_path: Path) -> None:
    first = PhysicsCell(tmp_path)
    async with first.cell:
        with pytest.raises(TaskFailed, match='no camera "above"; the scene has none'):
            await first.do("calibrateCamera", camera="above")
        scene = first.cell.scene.model_dump(mode="json")
        scene["cameras"]["above"] = {"position": [0.45, -0.45, 1.2]}
        for name, place in BALLS.items():
            scene["obstacles"][name] = {"sphere": 0.03, "position": place}
        await first.cell.change_scene(scene)
        with pytest.raises(TaskFailed, match="sees 2 balls, and 3 are needed"):
            await first.do("calibrateCamera", camera="above", targets=["ball-1", "ball-2"])
        joints = first.unit.joints
        result = await first.do("calibrateCamera", camera="above")
        assert first.unit.joints == pytest.approx(joints, abs=1e-6)
    assert result["balls"] == 4
    assert result["residualMm"] < 1.5
    assert 0.5 < result["movedMm"] < 4.0
    second = PhysicsCell(tmp_path)
    cameras = second.robot.vision.cameras  # type: ignore[union-attr]
    calibrated, true = cameras.calibrated("above").frame, cameras["above"].mount.frame
    assert math.dist(calibrated.position, true.position) < 0.003
    point = Frame(NO_TURN, (0.0, 0.0, 1.1))
    assert math.dist((calibrated @ point).position, (true @ point).position) < 0.001


@pytest.mark.nightly
async def test_the_scene_shows_the_true_parts_of_the_simulation_and_those_that_are_known(
    physics: PhysicsCell,
) -> None:
    view = scene_view(physics.cell)
    assert view["parts"] == []
    assert len(view["trueParts"]) == len(physics.parts.in_bin("bin-1"))
    assert view["trueParts"][0]["size"] == [0.024, 0.06, 0.024]
    seen = await physics.do("scan", bin="bin-1")
    await physics.do("pick", part=seen["part"], pose=seen["pose"])
    assert len(scene_view(physics.cell)["trueParts"]) == len(view["trueParts"]) - 1
    await physics.cell.change_scene(scene_view(physics.cell))


@pytest.mark.nightly
async def test_after_a_crash_in_a_motion_the_arm_and_its_part_are_where_they_were(tmp_path: Path) -> None:
    first = PhysicsCell(tmp_path)
    seen = await first.do("scan", bin="bin-1")
    await first.do("pick", part=seen["part"], pose=seen["pose"])
    stopped = 0

    def stop_on_the_way() -> float:
        nonlocal stopped
        stopped += 1
        return 1.0 if stopped < 300 else 0.0

    base = first.unit.joints
    assert not await first.robot.move(ROBOT.home, 1.0, stop_on_the_way)
    there = first.unit.joints  # the tool is not left in good order: nothing is stored now
    assert max(abs(a - b) for a, b in zip(there, base, strict=True)) > 0.05
    second = PhysicsCell(tmp_path)
    assert second.unit.joints == pytest.approx(there, abs=1e-3)
    async with second.cell:
        assert second.robot.is_holding
        assert (await second.do("place", location="fixture-1"))["part"] == seen["part"]


async def test_an_arm_whose_way_leads_into_the_table_does_not_begin(physics: PhysicsCell) -> None:
    home = ROBOT.home
    with pytest.raises(RobotFault, match="would touch"):
        await physics.robot.move((home[0], home[1] + 1.6, *home[2:]), 1.0, lambda: 1.0)
    assert physics.robot.state().positions == pytest.approx(home, abs=0.001)


async def test_a_simulation_that_fails_is_a_fault_and_runs_again(monkeypatch: pytest.MonkeyPatch) -> None:
    world = a_world(None)

    def fail(_: float) -> None:
        raise ArithmeticError("no solution")

    async with PhysicsRobot(world, NAME, ROBOT, ROBOT.limits) as robot:
        with monkeypatch.context() as broken:
            broken.setattr(world.simulation, "step_for", fail)
            with pytest.raises(RobotFault, match="the simulation has ended: no solution"):
                await robot.move(NEAR, 1.0, lambda: 1.0)
        assert await robot.move(NEAR, 1.0, lambda: 1.0)


async def test_an_arm_that_is_blocked_reports_a_fault_and_moves_again(physics: PhysicsCell) -> None:
    robot, home = physics.robot, ROBOT.home
    robot.limiter = JointLimiter(ROBOT.limits)  # it knows nothing of the table
    into_the_table = (home[0], home[1] + 1.6, *home[2:])
    with pytest.raises(RobotFault, match="meets something"):
        await robot.move(into_the_table, 1.0, lambda: 1.0)
    assert await robot.move(home, 0.5, lambda: 1.0)
    assert robot.state().positions == pytest.approx(home, abs=0.01)


FACING = Frame(((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)), (-1.2, 0.0, 0.0))


async def moves_of_two_arms() -> tuple[SharedWorld, bytes, int]:
    """Move two arms at once; return their world, its state, and the steps in which both were in motion."""
    models = {"left": ROBOT, "right": panda.ROBOT.mounted(FACING)}
    world = a_world(None, **models)
    holding = threading.Event()
    both = 0

    def pace() -> float:
        nonlocal both
        arms = [max(map(abs, arm.velocities)) > 0.05 for arm in world.simulation.arms.values()]
        both += all(arms)
        return 1.0

    async with (
        PhysicsRobot(world, "left", ROBOT, ROBOT.limits) as left,
        PhysicsRobot(world, "right", models["right"], panda.ROBOT.limits) as right,
    ):
        held = asyncio.create_task(left.in_control(lambda: holding.wait(60)))
        moves = [
            asyncio.create_task(
                robot.move((robot.setpoint.positions[0] + 0.4, *robot.setpoint.positions[1:]), 1, pace)
            )
            for robot in (left, right)
        ]
        await asyncio.sleep(0)  # all three are queued: time begins when the first one ends
        holding.set()
        assert await held
        assert all(await asyncio.gather(*moves))
        state = world.simulation.saved()["state"].tobytes()
    return world, state, both


async def test_two_arms_move_at_once_in_one_world_with_the_same_result_each_time() -> None:
    (world, first, both), (_, second, _) = await moves_of_two_arms(), await moves_of_two_arms()
    assert first == second
    assert both > 200
    assert world.simulation.arms["left"].positions[0] == pytest.approx(ROBOT.home[0] + 0.4, abs=0.005)
    assert world.simulation.arms["right"].positions[0] == pytest.approx(panda.ROBOT.home[0] + 0.4, abs=0.005)


async def test_an_arm_that_meets_another_arm_is_blocked_by_it() -> None:
    near = ROBOT.mounted(Frame(NO_TURN, (0.0, -0.45, 0.0)))
    world = a_world(None, left=ROBOT, right=near)
    async with PhysicsRobot(world, "left", ROBOT, ROBOT.limits) as left:
        with pytest.raises(RobotFault, match="meets something"):
            await left.move((ROBOT.home[0] + 1.5, *ROBOT.home[1:]), 1.0, lambda: 1.0)
    alone = a_world(None)
    async with PhysicsRobot(alone, NAME, ROBOT, ROBOT.limits) as free:
        assert await free.move((ROBOT.home[0] + 1.5, *ROBOT.home[1:]), 1.0, lambda: 1.0)


@pytest.mark.nightly
async def test_one_robot_takes_the_part_that_another_one_has_put_down(tmp_path: Path) -> None:
    scene = ur10.FOLDER / "bin_picking_physics.yaml"
    cell_file = tmp_path / "cell.yaml"
    cell_file.write_text(
        f"""
scene: {scene}
robots:
  left: {{model: ur10, driver: physics, speed: 1}}
  right: {{model: ur10, driver: physics, speed: 1, base: {{position: [-1.3, 0.9, 0], yaw_deg: 180}}}}
"""
    )
    physics = PhysicsCell(tmp_path, cell_file=cell_file)
    async with physics.cell:
        home = ROBOT.home

        async def left() -> dict[str, Any]:
            seen = await physics.do("scan", bin="bin-1")
            await physics.do("pick", part=seen["part"], pose=seen["pose"])
            placed = await physics.do("place", location="fixture-1")
            await physics.do("home")
            return placed

        async def right() -> None:
            for turn in (0.4, 0.0):
                await physics.do("moveTo", robot="right", joints=(home[0] + turn, *home[1:]))

        placed, _ = await asyncio.gather(left(), right())
        (part,) = physics.parts.in_fixture("fixture-1")
        await physics.do("pick", robot="right", part=placed["part"], pose=placed["pose"])
        await physics.do("home", robot="right")
        simulation = physics.robot.simulation
        assert (simulation.gripped_part("left"), simulation.gripped_part("right")) == (None, part)
        shown = scene_view(physics.cell)["trueParts"]
        assert len(shown) == len(physics.parts.in_bin("bin-1")), "each part once, without the held one"
    again = PhysicsCell(tmp_path, cell_file=cell_file)
    assert again.cell.units["right"].held == placed["part"]
    assert again.robot.simulation.gripped_part("right") == part


@pytest.mark.nightly
async def test_a_scene_without_bins_gets_one_while_the_robot_works(tmp_path: Path) -> None:
    empty = tmp_path / "empty.yaml"
    empty.write_text("name: empty\n")
    physics = PhysicsCell(tmp_path, scene_file=empty)
    full = load(ur10.FOLDER / "bin_picking_physics.yaml", ROBOT)
    async with physics.cell:
        await physics.cell.change_scene(full.model_dump(mode="json"))
        assert len(physics.parts.in_bin("bin-1")) == 6
        assert (await physics.do("scan", bin="bin-1"))["found"]
