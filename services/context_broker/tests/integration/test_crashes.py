"""Kills during all kinds of writes: every acknowledged change is there afterwards.

Four by default; HANDOVER_TEST_CRASHES says how many otherwise (`make crashes` cuts a hundred times).
"""

import os
import time
from typing import Any

import pytest

from tests.kit.waiting import Bound

from .writers import ALL_WAYS, Writer, compare, things_of

CUTS = int(os.environ.get("HANDOVER_TEST_CRASHES", "4"))
WRITERS = 6


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("own_broker", ["sqlite", "postgresql"], indirect=True)
def test_power_cuts_take_nothing_back_that_was_acknowledged(own_broker: Any) -> None:
    writers = [Writer(own_broker, number) for number in range(WRITERS)]
    for cut in range(CUTS):
        own_broker.start()
        with own_broker.client() as http:
            for writer in writers:
                compare(http, writer)
        writers = [Writer(own_broker, before.number, before) for before in writers]
        goal = sum(writer.count for writer in writers) + 60 + 40 * (cut % 4)
        for writer in writers:
            writer.start()
        bound = Bound(30)
        while sum(writer.count for writer in writers) < goal:
            bound.check("the writers do not advance")
            time.sleep(0.001)
        own_broker.kill()
        for writer in writers:
            writer.join(120)
            assert not writer.is_alive()
            assert writer.failures == []
    own_broker.start()
    with own_broker.client() as http:
        for writer in writers:
            compare(http, writer)
        answer = http.get("/entities", params={"type": "Load", "limit": 1000, "options": "keyValues"})
    assert {entity["id"] for entity in answer.json()} == things_of(writers)
    done = {way for writer in writers for way in writer.ways}
    assert done == ALL_WAYS
