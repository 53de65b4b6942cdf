"""A change that another broker on the same database overtakes is made again here, and passed on once."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

import httpx
import pytest

from tests.context_sources import ScriptedSource, put, register

from .several import Brokers

WRITERS, CHANGES = 4, 15


@pytest.fixture
def two(tmp_path_factory: pytest.TempPathFactory, new_database: Callable[[], str]) -> Iterator[Brokers]:
    """Two brokers on one database."""
    made = Brokers(tmp_path_factory.mktemp("two"), new_database())
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(made.started, (0, 1)))
    yield made
    made.stop()


def test_a_change_that_was_overtaken_is_passed_on_once(
    two: Brokers, source: ScriptedSource, kind: str, eventually: Callable[..., Any]
) -> None:
    one = f"urn:ngsi-ld:{kind}:1"
    at = f"/ngsi-ld/v1/entities/{one}"
    source.answers["PATCH", f"{at}/attrs"] = 204, None
    source.answers["POST", "/ngsi-ld/v1/entityOperations/update"] = 204, None
    with ExitStack() as stack:
        first, second = (stack.enter_context(two[number].client()) for number in range(2))
        put(first, one, kind, n=0)
        register(first, source.url, {"type": kind}, operations=["redirectionOps", "updateBatch"])
        eventually(lambda: len(second.get("/csourceRegistrations", params={"type": kind}).json()) == 1)

        def write(number: int) -> list[int]:
            statuses = []
            with two[number % 2].client() as client:
                for change in range(CHANGES):
                    said = number * CHANGES + change
                    if change % 3:
                        answer = client.patch(f"/entities/{one}/attrs", json={"n": said})
                    else:
                        answer = _in_a_batch(client, {"id": one, "type": kind, "n": said})
                    statuses.append(answer.status_code)
            return statuses

        with ThreadPoolExecutor(WRITERS) as pool:
            statuses = [status for some in pool.map(write, range(WRITERS)) for status in some]
        assert statuses == [204] * WRITERS * CHANGES
        assert sum(two[number].metric("handover_broker_commits_overtaken_total") for number in range(2)) > 0
        passed_on = [asked[4] for asked in source.asked if asked[0] in {"PATCH", "POST"}]
        told = [(said[0] if isinstance(said, list) else said)["n"] for said in passed_on]
        assert sorted(told) == list(range(WRITERS * CHANGES))


def _in_a_batch(client: httpx.Client, entity: dict[str, Any]) -> httpx.Response:
    return client.post("/entityOperations/update", json=[entity])
