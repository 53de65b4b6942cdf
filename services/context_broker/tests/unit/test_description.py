"""The OpenAPI description of NGSI-LD: refusals without a body, and reads that create an entity map."""

from pathlib import Path
from typing import Any

import pytest

from handover.errors import Problem
from handover_broker.api.description import paths_of
from handover_broker.app import operations_of
from handover_broker.request.request_context import problem_response
from handover_broker.settings import BrokerSettings


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    data_dir: Path = tmp_path_factory.mktemp("broker")
    return paths_of(operations_of(BrokerSettings(_env_file=None, data_dir=data_dir)))


def test_a_refusal_has_a_described_body_exactly_where_it_is_sent_with_one(
    paths: dict[str, dict[str, Any]],
) -> None:
    for methods in paths.values():
        for operation in methods.values():
            for status, response in operation["responses"].items():
                if int(status) >= 400:
                    sent = problem_response(Problem(int(status), "Refused", "for a test"))
                    assert bool(sent.body) == ("application/json" in response.get("content", {})), status


def test_every_query_that_can_create_an_entity_map_describes_201(paths: dict[str, dict[str, Any]]) -> None:
    creating = ("entities", "entityMaps", "temporal/entities", "temporal/entityMaps")
    for path in creating:
        assert "201" in paths[f"/ngsi-ld/v1/{path}"]["get"]["responses"], path
    assert "201" not in paths["/ngsi-ld/v1/types"]["get"]["responses"]
