"""PINs and performers of Tasks count with a proof only, whatever broker stores the Task.

The broker of these tests is a foreign one as far as proofs are concerned: without accounts of its own it
accepts every change of a Task from every program.
"""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from handover.broker import BrokerClient
from handover.security.access_tokens import SigningKey, key_set
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover_datamodels.times import iso
from handover_processes.running.orchestrator import Orchestrator, utc_now
from services.task_orchestrator.tests.integration.rest import settings_in
from services.task_orchestrator.tests.unit.drawing import drawing, end, path, start
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

KEY = SigningKey.generate()
ANNA, BEN = "urn:ngsi-ld:Person:demo:anna", "urn:ngsi-ld:Person:demo:ben"
OTHER_TASK = "urn:ngsi-ld:Task:demo:other-1"
SIGN = (
    '<bpmn:userTask id="sign" name="Release the batch"><bpmn:extensionElements>'
    '<handover:task definition="sign" requirePin="true"/></bpmn:extensionElements></bpmn:userTask>'
)
SIGN_WITHOUT_PIN = SIGN.replace(' requirePin="true"', "")


class Release:
    """A process whose only Task is `sign`."""

    def __init__(self, orchestrator: Orchestrator, broker: BrokerClient) -> None:
        self.orchestrator, self.broker = orchestrator, broker
        self.process = self.task = ""

    async def begin(self, sign: str) -> None:
        """Start the process, and wait until the broker has its Task."""
        await self.orchestrator.deployments.deploy(
            drawing(start() + sign + end() + path("start", "sign", "end"))
        )
        self.process, _ = await self.orchestrator.processes.start("p", {})
        self.task = f"urn:ngsi-ld:Task:demo:{self.process}-sign-1"

        async def is_delivered() -> bool:
            return not self.orchestrator.outbox.is_pending(self.task)

        await until(is_delivered, 30)

    async def answer(self, **outputs: Any) -> None:
        """Complete the Task in the broker, as any program can that reaches it."""
        completed = {"type": "Property", "value": "completed", "observedAt": iso(utc_now())}
        given = {"type": "Property", "value": outputs, "observedAt": iso(utc_now())}
        await self.broker.append(self.task, {"status": completed, "outputParameters": given})
        await self.orchestrator.broker_changes.receive(await self.broker.query(type="Task", id=[self.task]))

    async def record(self) -> Any:
        """Return the Task as the orchestrator has stored it."""
        return await self.orchestrator.tasklist.task(self.task)


@asynccontextmanager
async def a_release(broker: BrokerClient, folder: Path, sign: str) -> AsyncIterator[Release]:
    settings = settings_in(folder / "orchestrator", broker_url=broker.url.partition("/ngsi-ld")[0])
    settings.security_folder.mkdir(parents=True)
    (settings.security_folder / PUBLIC_KEYS_FILE).write_bytes(key_set(KEY))
    async with BrokerClient(settings) as client, Orchestrator(settings, client) as orchestrator:
        made = Release(orchestrator, broker)
        await made.begin(sign)
        yield made


@pytest.fixture
async def release(broker: BrokerClient, tmp_path: Path) -> AsyncIterator[Release]:
    """A release that demands a PIN."""
    async with a_release(broker, tmp_path, SIGN) as made:
        yield made


@pytest.fixture
async def release_without_pin(broker: BrokerClient, tmp_path: Path) -> AsyncIterator[Release]:
    async with a_release(broker, tmp_path, SIGN_WITHOUT_PIN) as made:
        yield made


async def test_with_the_proof_of_the_pin_the_task_is_completed(release: Release) -> None:
    await release.answer(performedBy=ANNA, pinProof=KEY.prove_pin(ANNA, release.task))
    assert (await release.record()).status.value == "completed"


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("prove", "person", "why"),
    [
        (lambda _: None, ANNA, "there is no proof"),
        (lambda _: KEY.prove_pin(ANNA, OTHER_TASK), ANNA, "another Task"),
        (lambda task: SigningKey.generate().prove_pin(ANNA, task), ANNA, "unknown key"),
        (lambda task: KEY.prove_pin(ANNA, task), BEN, "another person"),
        (lambda _: 17, ANNA, "there is no proof"),
    ],
)
async def test_without_it_the_task_fails_and_says_why(
    release: Release, prove: Any, person: str, why: str
) -> None:
    await release.answer(performedBy=person, outcome="ok", pinProof=prove(release.task))
    record = await release.record()
    assert record.status.value == "failed"
    assert why in record.outputs["reason"]

    async def is_corrected() -> bool:
        (entity,) = await release.broker.query(type="Task", id=[release.task])
        return bool(entity["status"]["value"] == "failed")

    await until(is_corrected, 30, "the broker shows what the orchestrator has decided")


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("prove", "person", "is_known"),
    [
        (lambda task: {"performerProof": KEY.prove_performer(ANNA, task)}, ANNA, True),
        (lambda task: {"pinProof": KEY.prove_pin(ANNA, task)}, ANNA, True),
        (lambda _: {}, ANNA, False),
        (lambda task: {"performerProof": KEY.prove_performer(ANNA, task)}, BEN, False),
        (lambda _: {"performerProof": KEY.prove_performer(ANNA, OTHER_TASK)}, ANNA, False),
        (lambda task: {"performerProof": KEY.prove_pin(ANNA, task)}, ANNA, False),
        (lambda task: {"performerProof": SigningKey.generate().prove_performer(ANNA, task)}, ANNA, False),
    ],
)
async def test_who_performed_a_task_is_taken_from_the_broker_with_a_proof_only(
    release_without_pin: Release, prove: Any, person: str, is_known: bool
) -> None:
    await release_without_pin.answer(performedBy=person, outcome="ok", **prove(release_without_pin.task))
    record = await release_without_pin.record()
    assert record.status.value == "completed", "the answer itself counts"
    assert record.outputs["outcome"] == "ok"
    assert record.outputs.get("performedBy") == (person if is_known else None)


async def test_a_proof_of_a_performer_is_none_of_the_pin(release: Release) -> None:
    await release.answer(performedBy=ANNA, pinProof=KEY.prove_performer(ANNA, release.task))
    assert (await release.record()).status.value == "failed"
