"""One of several brokers is killed while all write, again and again: nothing is lost, nothing told twice.

Half as often as `test_crashes.py` cuts, followers and leaders in turn. Only what a killed leader had sent and
not struck out yet is told again.
"""

import itertools
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from .conftest import BrokerProcess
from .several import Brokers
from .test_crashes import CUTS
from .writers import ALL_WAYS, Writer, compare, things_of

BROKERS = 3
WRITERS = 6
UNSTRUCK = 64
"""More than a leader sends before the next commit, which strikes out what was sent."""

Eventually = Callable[..., Any]
_marks = itertools.count()


@pytest.fixture
def brokers(tmp_path: Path, new_database: Callable[[], str]) -> Iterator[Brokers]:
    made = Brokers(tmp_path, new_database())
    for number in range(BROKERS):
        made.started(number)
    yield made
    made.stop()


def all_agree(brokers: list[BrokerProcess], eventually: Eventually) -> None:
    """Wait until every broker has what was written before now: changes have one order for all of them."""
    mark = f"/entities/urn:ngsi-ld:Mark:demo:{next(_marks)}"
    with brokers[0].client() as http:
        made = {"id": mark.removeprefix("/entities/"), "type": "Mark"}
        assert http.post("/entities", json=made).status_code == 201
    for broker in brokers:
        with broker.client() as http:
            eventually(lambda http=http: http.get(mark).status_code == 200)


def repeated(subscriber: Any) -> int:
    """How many notifications came more often than once."""
    return sum(times - 1 for times in Counter(one["id"] for one in subscriber.received).values())


def work_until(writers: list[Writer], more: int, eventually: Eventually) -> None:
    goal = sum(writer.count for writer in writers) + more
    eventually(lambda: sum(writer.count for writer in writers) >= goal, 60, "the writers do not get on")


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_when_one_of_several_is_killed_nothing_is_lost_and_nothing_is_told_twice(
    brokers: Brokers, subscriber: Any, eventually: Eventually
) -> None:
    everyone = [brokers[number] for number in range(BROKERS)]
    with everyone[0].client() as http:
        endpoint = {"uri": subscriber.url, "accept": "application/json"}
        wish = {
            "type": "Subscription",
            "entities": [{"type": "Load"}],
            "notification": {"endpoint": endpoint, "format": "keyValues"},
        }
        assert http.post("/subscriptions", json=wish).status_code == 201
    all_agree(everyone, eventually)
    writers = [Writer(everyone[number % BROKERS], number) for number in range(WRITERS)]
    for cut in range(CUTS // 2):
        leader = eventually(brokers.leader)
        victim = leader if cut % 2 else next(broker for broker in everyone if broker is not leader)
        before = repeated(subscriber)
        writers = [Writer(writer.broker, writer.number, writer) for writer in writers]
        for writer in writers:
            writer.start()
        work_until(writers, 60 + 20 * (cut % 3), eventually)
        victim.kill()
        for writer in writers:
            if writer.broker is victim:
                writer.join(120)
                assert not writer.is_alive()
        work_until(writers, 40, eventually)  # the others go on
        for writer in writers:
            writer.over.set()
        for writer in writers:
            writer.join(120)
            assert not writer.is_alive()
            assert writer.failures == []
        victim.start()
        all_agree(everyone, eventually)
        for broker in everyone:
            with broker.client() as http:
                for writer in writers:
                    compare(http, writer)
        promised = {
            (thing, number) for writer in writers for thing, told in writer.told.items() for number in told
        }
        eventually(lambda promised=promised: promised <= told_to(subscriber), 60, "some were not told")
        assert repeated(subscriber) - before <= (UNSTRUCK if victim is leader else 0)
    lists = [ids_of_loads(broker) for broker in everyone]
    assert lists[0] == lists[1] == lists[2]
    assert set(lists[0]) == things_of(writers)
    assert {way for writer in writers for way in writer.ways} <= ALL_WAYS


def told_to(subscriber: Any) -> set[tuple[str, int]]:
    return {(one["id"], one["n"]) for one in subscriber.entities() if "n" in one}


def ids_of_loads(broker: BrokerProcess) -> list[str]:
    with broker.client() as http:
        answer: httpx.Response = http.get("/entities", params={"type": "Load", "limit": 1000})
        return [one["id"] for one in answer.json()]
