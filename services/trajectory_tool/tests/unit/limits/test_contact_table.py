"""The contact table: two bodies and a spring, its file, and a plan that is slowed down or refused."""

import math
from pathlib import Path
from time import time as now
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.errors import UsageError
from handover.performer import TaskFailed
from handover_datamodels.streams import PeopleReport
from handover_robots.cell.cell import RobotCell
from handover_robots.limits.contact_table import BodyRegion, ContactEntry, ContactSpeed, speed_mps
from handover_robots.limits.robot_limits import RobotLimits
from handover_robots.limits.store import LimitStore
from handover_robots.model.obstacles import Box
from handover_robots.model.poses import Pose
from handover_robots.model.trajectory import Setpoint
from handover_robots.robots import ROBOTS
from handover_robots.scene.scene import Zone
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks.work import Work
from services.trajectory_tool.tests.unit.conftest import Freely, JumpingTime

UR10 = ROBOTS.load("ur10")
HAND = {"mass_kg": 0.6, "stiffness_n_per_mm": 75, "transient": {"force_n": 280}, "clamped": {"force_n": 140}}
CHEST = {"mass_kg": 40, "stiffness_n_per_mm": 25, "transient": {"force_n": 280, "pressure_n_per_cm2": 240}}
TABLE = {
    "source": "values of this test, which are those of no standard",
    "confirmed_by": "Aino",
    "confirmed_at": "2026-03-02T00:00:00Z",
    "regions": {"hand": HAND, "chest": CHEST},
}
ENTRY = {"table": "contact.yaml", "regions": ["hand"], "moving_mass_kg": 16, "load_kg": 2}
VALUES = st.floats(0.1, 500)


def entry(**values: Any) -> ContactEntry:
    return ContactEntry.model_validate({**ENTRY, **values})


def cell_with(
    folder: Path, contact: dict[str, Any], table: Any = TABLE, clock: Any = None, **scene: Any
) -> RobotCell:
    (folder / "contact.yaml").write_text(table if isinstance(table, str) else yaml.safe_dump(table))
    robots = {"ur10-1": {"contact": {**ENTRY, **contact}}}
    (folder / "cell.yaml").write_text(yaml.safe_dump({"scene": {"name": "cell", **scene}, "robots": robots}))
    return RobotCell(TrajectorySettings.load(data_dir=folder, cell_file=folder / "cell.yaml"), clock)


def test_the_force_of_the_two_body_model_is_the_limit() -> None:
    speed = speed_mps(entry(), "hand", BodyRegion.model_validate(HAND))
    reduced_kg = 1 / (1 / 10 + 1 / 0.6)
    assert speed == pytest.approx(1.36, abs=0.01)
    assert reduced_kg * speed**2 / 2 == pytest.approx(280**2 / (2 * 75e3)), "the energy of the spring"
    clamped = speed_mps(entry(may_clamp=True), "hand", BodyRegion.model_validate(HAND))
    assert clamped == pytest.approx(140 / math.sqrt(10 * 75e3))


def test_a_small_area_makes_the_pressure_the_limit() -> None:
    region = BodyRegion.model_validate(CHEST)
    wide, narrow = (speed_mps(entry(contact_area_cm2=area), "chest", region) for area in (2.0, 0.5))
    assert narrow / wide == pytest.approx(0.5 * 240 / 280)


@given(st.tuples(VALUES, VALUES, VALUES, VALUES), st.floats(1, 3), st.booleans())
def test_more_mass_or_stiffness_and_less_force_never_raise_the_speed(
    values: tuple[float, float, float, float], more: float, may_clamp: bool
) -> None:
    mass_kg, stiffness, force_n, moving_kg = values

    def speed(mass: float, spring: float, force: float, moving: float) -> float:
        limit = {"force_n": force}
        region = {"mass_kg": mass, "stiffness_n_per_mm": spring, "transient": limit, "clamped": limit}
        return speed_mps(
            entry(moving_mass_kg=moving, may_clamp=may_clamp), "hand", BodyRegion.model_validate(region)
        )

    most = speed(mass_kg, stiffness, force_n, moving_kg) * (1 + 1e-9)
    assert speed(mass_kg * more, stiffness, force_n, moving_kg) <= most
    assert speed(mass_kg, stiffness * more, force_n, moving_kg) <= most
    assert speed(mass_kg, stiffness, force_n / more, moving_kg) <= most
    assert speed(mass_kg, stiffness, force_n, moving_kg * more) <= most


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> LimitStore:
    return LimitStore(tmp_path_factory.mktemp("limits") / "limits.json")


@settings(deadline=None, max_examples=40)
@given(st.floats(0.001, 10), st.lists(st.floats(-2, 2), min_size=6, max_size=6))
def test_a_contact_table_never_raises_a_limit(store: LimitStore, mps: float, velocities: list[float]) -> None:
    table = {**TABLE, "regions": {"hand": HAND}}
    permitted = ContactSpeed.model_validate({"region": "hand", "speed_mps": mps, "table": table})
    without = RobotLimits("ur10-1", UR10, lambda: UR10.home, store)
    limits = RobotLimits("ur10-1", UR10, lambda: UR10.home, store, contact_speed=permitted)
    moving = Setpoint(UR10.home, tuple(velocities), (0.0,) * 6)
    for robot_limits in (without, limits):
        robot_limits.begin_motion(lambda _: moving, 0.1)
    assert limits.pace() <= without.pace()
    assert limits.tool_limit_mps() <= without.tool_limit_mps()
    assert limits.pace() * limits.peak_mps <= mps * (1 + 1e-9)


@pytest.mark.parametrize(
    ("contact", "table", "fault"),
    [
        ({"regions": ["knee"]}, TABLE, 'no region "knee"; it has'),
        ({"regions": ["chest"]}, TABLE, "contact_area_cm2"),
        ({"regions": ["chest"], "contact_area_cm2": 1, "may_clamp": True}, TABLE, 'enter "clamped"'),
        ({}, {**TABLE, "confirmed_at": None}, "confirmed_at"),
        ({}, {**TABLE, "regions": {"hand": {**HAND, "mass_kg": 0}}}, "mass_kg"),
        ({}, {**TABLE, "regions": {"hand": {**HAND, "mass_kg": math.nan}}}, "mass_kg"),
        ({}, "[", "not YAML"),
        ({"table": "absent.yaml"}, TABLE, "cannot be read"),
    ],
)
def test_an_invalid_table_is_refused(tmp_path: Path, contact: dict[str, Any], table: Any, fault: str) -> None:
    with pytest.raises(UsageError, match=fault):
        cell_with(tmp_path, contact, table)


async def test_a_motion_is_slowed_down_or_refused(tmp_path: Path, time: JumpingTime) -> None:
    class Steered(Freely):
        async def rest(self) -> None:
            return

    weak = {**HAND, "transient": {"force_n": 0.5}}
    for table, is_refused in ((TABLE, False), ({**TABLE, "regions": {"hand": weak}}, True)):
        made = cell_with(tmp_path, {"moving_mass_kg": 200}, table, time.clock)
        async with made:
            unit = made.only
            work = Work("task", "moveTo", unit, Steered(), 1.0)
            target = (unit.joints[0] + 1.5, *unit.joints[1:])
            if is_refused:
                with pytest.raises(TaskFailed, match="contacts with hand, confirmed on 2026-03-02"):
                    await work.go(target)
                assert unit.joints[0] == pytest.approx(1.5)
                return
            await work.go((1.5, *unit.joints[1:]))
            lowest = unit.speed.lowest()
            assert lowest is not None
            assert lowest.rule == "contact"
            assert unit.speed.pace() < 1.0


@pytest.mark.parametrize(
    ("y", "is_slow"), [(-0.8, True), (0.8, False)], ids=["on the way of the arm", "elsewhere"]
)
async def test_contacts_limit_motions_only_where_people_may_be(
    tmp_path: Path, time: JumpingTime, y: float, is_slow: bool
) -> None:
    """The arm of the UR10 turns from -x to -y; its tool is 0.7 m from the axis."""
    zone = {"kind": "people", "box": [0.4, 0.4, 2], "position": [-0.2, y, 0.5]}
    made = cell_with(tmp_path, {"moving_mass_kg": 200}, clock=time.clock, zones={"bench": zone})
    async with made:
        unit = made.only
        await Work("task", "moveTo", unit, Freely(), 1.0).go((1.5, *unit.joints[1:]))
        slowest = min(unit.speed.allowed(), key=lambda rule: rule.fraction)
        assert (slowest.rule, slowest.fraction < 0.9) == ("contact", is_slow)
        assert unit.speed.tool_limit_mps() == math.inf
        (bench,) = unit.speed.zones
        permitted = unit.speed.contact_speed
        assert permitted is not None
        assert bench.max_tool_speed_mps == permitted.speed_mps, "what limits commanded velocities there"


def test_a_zone_knows_what_comes_near() -> None:
    zone = Zone(
        "bench", Box((0.4, 0.4, 0.4)), Pose((1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), "people", math.inf
    )
    through = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)]
    beside = [(0.0, 0.35, 0.0), (2.0, 0.35, 0.0)]
    assert zone.is_near(through, 0.0)
    assert not zone.is_near(beside, 0.05)
    assert zone.is_near(beside, 0.16)


async def test_a_robot_at_rest_names_the_warning_field_that_would_slow_it(store: LimitStore) -> None:
    limits = RobotLimits("ur10-2", UR10, lambda: UR10.home, store, now=lambda: 100.0)
    await limits.receive_people(PeopleReport(source="scanner-1", stamp=now(), people=[], warning_field=True))
    slow = Setpoint(UR10.home, (0.01,) * 6, (0.0,) * 6)
    for is_named, change in ((True, None), (False, slow), (True, "end")):
        if isinstance(change, Setpoint):
            limits.begin_motion(lambda _: slow, 0.1)
        elif change is not None:
            limits.end_motion()
        lowest = limits.lowest()
        assert (lowest is not None and lowest.reason == "the warning field is infringed") is is_named
