"""A performer never sees a Task before its TaskDefinition: the broker refuses it, and a kill follows."""

from pathlib import Path

import pytest

from services.task_orchestrator.tests.integration.cell import Cell, eventually
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, path, start
from tests.kit.ports import next_free_port
from tests.kit.refusing_proxy import RefusingProxy, refusing_proxy

pytestmark = pytest.mark.slow

WEIGH = "urn:ngsi-ld:TaskDefinition:demo:weigh"


def refused_again(proxy: RefusingProxy) -> None:
    """Wait until the broker has refused two more writes."""
    before = proxy.refusals
    eventually(lambda: proxy.refusals >= before + 2, "more refusals")


@pytest.mark.nightly
def test_a_task_waits_for_its_definition_over_a_kill(tmp_path: Path) -> None:
    running = Cell(tmp_path, next_free_port)
    broker = running.broker.environment["HANDOVER_BROKER_URL"]
    with refusing_proxy(broker) as proxy:
        running.orchestrator.environment = {
            **running.orchestrator.environment,
            "HANDOVER_BROKER_URL": proxy.url,
        }
        try:
            running.broker.start()
            running.orchestrator.start()
            proxy.refused = frozenset({WEIGH.encode() + b'","type":"TaskDefinition"'})
            xml = drawing(
                start() + activity("weigh") + end() + path("start", "weigh", "end"), name="weighing"
            )
            answer = running.api.post(
                "/definitions", content=xml, headers={"Content-Type": "application/xml"}
            )
            assert answer.status_code == 201, answer.text
            process = running.start("weighing")
            refused_again(proxy)
            assert running.tasks(process) == []
            running.orchestrator.kill()
            running.orchestrator.start()
            refused_again(proxy)
            assert running.tasks(process) == []
            proxy.refused = frozenset()
            (task,) = eventually(lambda: running.tasks(process), "the Task")
            assert task["isDefinedBy"]["object"] == WEIGH
            assert running.entity(WEIGH) is not None
            bodies = [body for _, body in proxy.accepted]
            defined = next(
                n
                for n, body in enumerate(bodies)
                if b'"type":"TaskDefinition"' in body and WEIGH.encode() in body
            )
            posted = next(
                n for n, body in enumerate(bodies) if task["id"].encode() in body and b'"pending"' in body
            )
            assert defined < posted
        finally:
            running.api.close()
            running.entities.close()
            for member in reversed(running.members):
                member.stop()
