"""A strange value is refused or has a meaning: no route of a service fails, then or at a later read."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import httpx
import pytest

from tests.integration.cell.test_perimeter import SERVICES
from tests.kit.cell import Cell, new_cell
from tests.kit.described_requests import DescribedRequest, DescribedRequests

pytestmark = pytest.mark.slow

EVERY = 1 if "HANDOVER_TEST_EXAMPLES" in os.environ else 17
"""Of the strange values at one place, which part is sent; null is always sent."""
WITHOUT_BODIES = {"webui", "ros_fiware_bridge"}
"""Services whose description names no body."""
NO_ALERT = "urn:ngsi-ld:Device:no-alert"
EXISTING = {"human_state": {"driver": "heart-rate-strap"}, "webui": {"alert_id": NO_ALERT}}
"""Values of path parameters that are refused for another reason than that they are unknown."""


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with new_cell(tmp_path_factory.mktemp("cell")) as made:
        made.extra["HANDOVER_ASSISTIVE_MACHINES"] = "bed"
        made.extra |= {"HANDOVER_HUMANOID_MODEL": "coman", "HANDOVER_HUMANOID_FIFO": "false"}
        made.start(*SERVICES, within_s=90.0)
        entities = f"{made.url('context_broker')}/ngsi-ld/v1/entities"
        httpx.post(entities, json={"id": NO_ALERT, "type": "Device"}, trust_env=False).raise_for_status()
        yield made


@contextmanager
def answered(http: httpx.Client, request: DescribedRequest) -> Iterator[httpx.Response]:
    """Send a request; streams are not read."""
    headers = {} if request.content is None else {"Content-Type": "application/json"}
    with http.stream(request.method, request.target, content=request.content, headers=headers) as answer:
        yield answer


@pytest.mark.nightly
@pytest.mark.parametrize("service", SERVICES[1:])
def test_no_route_of_a_service_fails_for_a_strange_value_nor_a_read_after_it(
    cell: Cell, service: str
) -> None:
    with httpx.Client(base_url=cell.url(service), timeout=120, trust_env=False) as http:
        described = DescribedRequests(http.get("/openapi.json").json(), EXISTING.get(service))
        failing = {path for path in described.reads() if http.get(path).status_code >= 500}
        bodies, refusals, undescribed = 0, described.refusals(), set[tuple[str, str, int]]()
        for request in (*described.valid(), *described.strange(EVERY)):
            with answered(http, request) as answer:
                is_known = answer.status_code in {501, 502, 503, 504}  # what it would need does not run here
                assert answer.status_code < 500 or is_known, (request, answer.read())
                if answer.status_code >= 400:
                    undescribed |= {(request.method, request.template, answer.status_code)} - refusals
                    assert answer.headers["content-type"] == "application/problem+json", request
            bodies += request.content is not None
        assert bodies or service in WITHOUT_BODIES
        assert not undescribed
        for path in described.reads():
            answer = http.get(path)
            assert answer.status_code < 500 or path in failing, (path, answer.text)
        assert http.get("/readyz").status_code == 200
