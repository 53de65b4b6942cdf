"""Places of people in a real broker limit a robot: fresh ones, those that are no longer written, and none."""

import asyncio
import contextlib
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from handover.broker import BrokerClient
from handover.settings import Settings
from handover_datamodels.entities import Person
from handover_datamodels.times import iso
from handover_robots.limits.robot_limits import RobotLimits
from handover_robots.limits.store import LimitStore
from handover_robots.people.entities import SOURCE, STALE_S, PersonEntities, seen_of
from handover_robots.robots import ROBOTS
from tests.kit.cell import Cell
from tests.kit.waiting import until

AINO = "urn:ngsi-ld:Person:demo:aino"
UR10 = ROBOTS.load("ur10")


def person(x: float, y: float, age_s: float = 0.0) -> Person:
    observed = iso(datetime.now(UTC) - timedelta(seconds=age_s))
    place = {"type": "Property", "value": [x, y], "observedAt": observed}
    return Person.from_ngsild({"id": AINO, "type": "Person", "relativePosition": place})


@pytest.mark.nightly
@pytest.mark.slow
async def test_a_person_in_the_broker_counts_until_a_person_confirms_that_nobody_is_there(
    cell: Cell, tmp_path: Path
) -> None:
    cell.start("context_broker")
    limits = RobotLimits("ur10-1", UR10, lambda: UR10.home, LimitStore(tmp_path / "limits.json"))

    async def write(x: float) -> None:
        while True:
            await broker.upsert([person(x, 0.0)])
            await asyncio.sleep(0.1)

    async with BrokerClient(Settings.load(broker_url=cell.url("context_broker"))) as broker:
        tasks = [asyncio.create_task(PersonEntities(broker, limits.receive_people).run())]
        tasks += [asyncio.create_task(limits.run()), asyncio.create_task(write(8.0))]
        await until(lambda: limits.separation.sources == (SOURCE,), 30, "no report")
        await until(lambda: limits.state.distance_m is not None and limits.pace() == 1.0, 30, "not far")
        tasks.pop().cancel()
        tasks.append(asyncio.create_task(write(0.9)))
        await until(lambda: limits.pace() == 0.0 and "demo:aino is near" in limits.state.allowed.reason, 30)
        tasks.pop().cancel()
        await until(lambda: limits.state.lost == ("demo:aino",), 30, "not vanished")
        await limits.confirm_clear("Anna")
        await until(lambda: limits.pace() == 1.0, 30, "still stopped")
        cell.kill("context_broker")
        await until(lambda: limits.pace() == 0.0 and "silent" in limits.state.allowed.reason, 30)
        for task in tasks:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task


def test_an_old_place_counts_with_its_age_only_when_the_tool_starts() -> None:
    now_s = datetime.now(UTC).timestamp()
    fresh = seen_of(person(1.0, 2.0, 0.5), now_s, with_stale=False)
    assert fresh is not None
    assert fresh.point == (1.0, 2.0)
    assert fresh.age == pytest.approx(0.5, abs=0.05)
    old = person(1.0, 2.0, 3600)
    assert seen_of(old, now_s, with_stale=False) is None
    at_start = seen_of(old, now_s, with_stale=True)
    assert at_start is not None
    assert at_start.age > STALE_S


def test_a_place_in_the_future_or_without_a_meaning_is_not_fresh() -> None:
    now_s = datetime.now(UTC).timestamp()
    assert seen_of(person(1.0, 2.0, -3600), now_s, with_stale=False) is None
    assert seen_of(person(1e9, 2.0), now_s, with_stale=False) is None
    unknown = Person.from_ngsild({"id": AINO, "type": "Person"})
    assert seen_of(unknown, now_s, with_stale=True) is None
