"""The end of a Task is reported until the broker takes it; what was done is never reported as failed."""

from collections.abc import Iterator

import httpx
import pytest

from tests.integration.cell.test_performer import LampProcess, a_task
from tests.kit.cell import Cell, new_cell
from tests.kit.refusing_proxy import RefusingProxy, refusing_proxy
from tests.kit.waiting import wait_for

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with new_cell(tmp_path_factory.mktemp("cell")) as made:
        made.start("context_broker")
        yield made


@pytest.fixture(scope="module")
def proxy(cell: Cell) -> Iterator[RefusingProxy]:
    """The way of the lamp to the broker."""
    with refusing_proxy(cell.url("context_broker")) as made:
        cell.extra["HANDOVER_BROKER_URL"] = made.url
        LampProcess(cell).start()
        yield made


@pytest.fixture
def entities(cell: Cell) -> Iterator[httpx.Client]:
    link = f'<{cell.settings.context_url}>; rel="http://www.w3.org/ns/json-ld#context"'
    headers = {"Link": f'{link}; type="application/ld+json"'}
    url = f"{cell.url('context_broker')}/ngsi-ld/v1/entities"
    with httpx.Client(base_url=url, headers=headers, timeout=120, trust_env=False) as client:
        yield client


@pytest.mark.nightly
@pytest.mark.parametrize("status", [401, 403, 404, 408, 409, 429, 500, 503, 507])
def test_an_end_that_the_broker_refuses_for_a_while_is_reported_as_it_was(
    proxy: RefusingProxy, entities: httpx.Client, status: int
) -> None:
    task = a_task(f"refused-{status}", steps=1).to_normalized()
    proxy.status, proxy.refusals, proxy.refused = status, 0, frozenset({b'"completed"'})
    entities.post("", json=task).raise_for_status()
    wait_for(lambda: proxy.refusals >= 2 or status == 404, 60, "the end is not reported again")
    wait_for(lambda: proxy.refusals >= 1, 60, "the end is not reported")

    def seen() -> dict[str, object]:
        found: dict[str, object] = entities.get(f"/{task['id']}").raise_for_status().json()
        return found

    assert seen()["status"]["value"] in {"assigned", "inProgress"}  # type: ignore[index]
    proxy.refused = frozenset()
    wait_for(lambda: seen()["status"]["value"] in {"completed", "failed"}, 60, "it hangs")  # type: ignore[index]
    assert seen()["status"]["value"] == "completed"  # type: ignore[index]
    assert seen()["outputParameters"]["value"] == {"lit": True}  # type: ignore[index]


@pytest.mark.parametrize("status", [400, 422])
def test_a_task_whose_outputs_the_broker_refuses_is_completed_without_them(
    proxy: RefusingProxy, entities: httpx.Client, status: int
) -> None:
    task = a_task(f"outputs-{status}", steps=1).to_normalized()
    proxy.status, proxy.refused = status, frozenset({b'"lit"'})
    entities.post("", json=task).raise_for_status()

    def ended() -> dict[str, object] | None:
        found = entities.get(f"/{task['id']}").raise_for_status().json()
        return found if found["status"]["value"] in {"completed", "failed"} else None

    found = wait_for(ended, 60, "it hangs")
    proxy.refused = frozenset()
    assert found is not None
    assert found["status"]["value"] == "completed"  # type: ignore[index]
    assert "could not be reported" in found["outputParameters"]["value"]["reason"]  # type: ignore[index]


def test_the_lamp_has_done_each_task_once(cell: Cell, proxy: RefusingProxy) -> None:
    taken = [line for line in cell.log("lamp").splitlines() if "task moved" in line and "inProgress" in line]
    names = [line.split("task=")[1].split()[0] for line in taken]
    assert len(names) == len(set(names))
    assert proxy.accepted
