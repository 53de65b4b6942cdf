"""The gesture controller: accepts Tasks for gloves and their wearers, and prompts for a gesture."""

import asyncio
from collections.abc import Mapping
from contextlib import AsyncExitStack
from dataclasses import replace
from functools import partial
from typing import Any, Self

from handover.broker import BrokerClient
from handover.database import connect
from handover.errors import Problem
from handover.performer import Job, Performer, RequestedAction, TaskFailed
from handover.runtime.background_tasks import BackgroundTasks
from handover.service_addresses import GESTURE_CONTROLLER
from handover.telemetry import get_logger
from handover_datamodels.states import Outcome
from handover_gloves.calibration.calibration_store import CalibrationStore
from handover_gloves.calibration.drift_persistence import SAVE_INTERVAL_S, DriftPersistence
from handover_gloves.calibration.glove_store import GloveStore
from handover_gloves.configuration.gestures_file import Configuration
from handover_gloves.connection.admission import TokenStore
from handover_gloves.connection.broker_reports import BrokerReports
from handover_gloves.connection.glove_registry import GloveRegistry
from handover_gloves.gloves.gesture_responder import Station
from handover_gloves.gloves.glove import Glove
from handover_gloves.people.people import People
from handover_gloves.people.station_joins import StationJoins
from handover_gloves.people.store import PeopleStore
from handover_gloves.people.study_condition_store import StudyConditionStore
from handover_gloves.prompting.prompt import GesturePrompt, PromptAnswer, PromptSpec
from handover_gloves.prompting.prompt_resolver import (
    find_definition,
    handles_outcomes,
    requires_pin,
    resolve_prompt,
)
from handover_gloves.recognition.frames import is_glove_name
from handover_gloves.settings import ControllerSettings
from handover_gloves.specifications.database import SpecificationDatabase

log = get_logger(__name__)

MAX_CHECK_INTERVAL_S = 0.1
DEVICE_REFRESH_INTERVAL_S = 60.0
"""How often unchanged Device entities are written: somebody may have deleted them."""


class GestureController(Performer):
    """Performs Tasks with every glove and its wearer; an asynchronous context manager."""

    def __init__(
        self,
        settings: ControllerSettings,
        configuration: Configuration,
        broker: BrokerClient,
        joins: StationJoins,
    ) -> None:
        super().__init__(GESTURE_CONTROLLER, settings, broker, notify_url=settings.notify_url)
        self.configuration = configuration
        self._joins = joins
        self._silence_s = settings.silence_s
        self._specification_timeout_s = settings.specification_timeout_s
        self._reports = BrokerReports(settings, broker)
        self.specifications = SpecificationDatabase(
            settings.specifications, self._reports.specification_database_changed
        )
        self._without_glove: dict[Job, str] = {}
        """The paused jobs of people who wear no glove, and the reason of each pause."""
        self._new_resources: asyncio.Queue[str] = asyncio.Queue()
        self._exit_stack = AsyncExitStack()
        self.database = connect(settings.database("gesture_controller"))
        store = GloveStore(self.database, settings.data_dir / "gloves")
        self.people = People(configuration, PeopleStore(self.database))
        tokens = TokenStore(self.database)
        self.registry = GloveRegistry(
            settings,
            store=store,
            tokens=tokens,
            people=self.people,
            conditions=StudyConditionStore(self.database),
            listener=self._reports,
            adopted=self._adopt,
        )
        self.calibrations = CalibrationStore(self.database)
        self._drifts = DriftPersistence(self.calibrations, self.registry.known, self.registry.records)

    async def __aenter__(self) -> Self:
        await self._exit_stack.enter_async_context(self._reports)
        tasks = await self._exit_stack.enter_async_context(BackgroundTasks("gesture controller"))
        for loop in (
            self._act_for_new_resources,
            self._check_gloves,
            self._save_drifts,
            self._refresh_devices,
        ):
            tasks.start(loop)
        tasks.start_restarting(self._joins.follow)
        tasks.start_restarting(self._joins.send)
        return await super().__aenter__()

    async def __aexit__(self, *error: object) -> None:
        await super().__aexit__(*error)
        await self._exit_stack.aclose()
        await self._drifts.save(min_change=0.0)
        self.database.dispose()

    async def may_repeat(self, job: Job) -> bool:  # noqa: ARG002
        """Return True: a person may be prompted again."""
        return True

    async def perform(self, job: Job) -> Mapping[str, Any]:
        """Prompt the wearer for the gesture of the Task, and return the outputParameters of the answer."""
        glove = await self._wait_for_glove(job)
        await self._assign_wearer(job, glove)
        spec = await self._resolve(job, glove)
        while (busy := self._busy_glove(glove, spec)) is not None:
            await _wait_or_interrupt(job, busy.responder.free.wait())
            await job.checkpoint()
        prompt = GesturePrompt(spec, job, asyncio.get_running_loop().create_future())
        glove.responder.begin(prompt)
        self.registry.wearers.equip(glove)
        self._join_hands(glove)
        try:
            answer = await self._wait_for_answer(glove, prompt)
        finally:
            glove.responder.end()
            self.registry.wearers.equip(glove)
        log.info(
            "task answered",
            glove=glove.name,
            gesture=answer.gesture,
            by=answer.by,
            outcome=answer.outcome.value,
        )
        if answer.performed_by is not None and answer.pin_proof is None:
            proof = await self._joins.proof_of(answer.performed_by, spec.task_id)
            answer = replace(answer, performer_proof=proof)
        if answer.outcome is Outcome.OK or await handles_outcomes(job.task, job.parameters, self.broker):
            return answer.outputs()
        raise answer.failure()

    async def _wait_for_glove(self, job: Job) -> Glove:
        """Return the glove of the job once it is free; the Task is paused while its person wears none."""
        while True:
            glove = self._glove_for(job.resource)
            if glove is None:
                self._without_glove[job] = f"{job.resource.rsplit(':', 1)[-1]} wears no glove"
                job.pause(self._without_glove[job])
                try:
                    await job.checkpoint()
                finally:
                    job.resume(self._without_glove.pop(job, ""))
            elif glove.responder.prompt is None:
                return glove
            else:
                await _wait_or_interrupt(job, glove.responder.free.wait())
                await job.checkpoint()

    def _glove_for(self, resource: str) -> Glove | None:
        for glove in self.registry.known:
            if self.settings.entity_id("Device", glove.name) == resource:
                return glove
        return next(iter(self.registry.known.worn_by(self._person_of(resource))), None)

    def _person_of(self, resource: str) -> str | None:
        """Return the name of a Person of this factory."""
        name = resource.rsplit(":", 1)[-1]
        return name if self.settings.entity_id("Person", name) == resource else None

    async def _assign_wearer(self, job: Job, glove: Glove) -> None:
        """If a Task for a glove involves a Person, let that person wear the glove."""
        if job.resource != self.settings.entity_id("Device", glove.name):
            return
        for link in job.task.involves or ():
            person = self._person_of(link.object)
            if person is not None and is_glove_name(person):
                try:
                    await self.registry.wearers.wear(glove, person)
                except Problem as problem:
                    log.warning("the wearer was not stored", glove=glove.name, error=str(problem))
                return

    def _busy_glove(self, glove: Glove, spec: PromptSpec) -> Glove | None:
        """Return a glove that the prompt needs and that still has another prompt."""
        partner = self.registry.known.partner_of(glove) if spec.hands == "both" else None
        needed = (worn for worn in (glove, partner) if worn is not None)
        return next((worn for worn in needed if worn.responder.prompt is not None), None)

    def _join_hands(self, glove: Glove) -> None:
        """Let the other hand take part in a two-hand prompt, as soon as its glove is known and free."""
        responder = glove.responder
        if responder.prompt is None or responder.partner is not None or responder.prompt.spec.hands == "one":
            return
        partner = self.registry.known.partner_of(glove)
        if partner is not None and partner.responder.prompt is None:
            responder.join(partner.responder)
            self.registry.wearers.equip(partner)

    async def _wait_for_answer(self, glove: Glove, prompt: GesturePrompt) -> PromptAnswer:
        following = asyncio.create_task(_follow_requests(glove, prompt.job))
        try:
            while not prompt.answer.done():
                await prompt.job.checkpoint()
                glove.responder.listen()
                await _wait_or_interrupt(prompt.job, asyncio.wait({prompt.answer}))
        finally:
            await _cancel(following)
        return prompt.answer.result()

    async def _resolve(self, job: Job, glove: Glove) -> PromptSpec:
        definition = await find_definition(
            job.task, job.parameters, self.broker, self.specifications, self._specification_timeout_s
        )
        state = self.specifications.state
        has_condition = self.registry.wearers.condition_of(glove) is not None
        try:
            spec = resolve_prompt(
                job.task,
                job.parameters,
                definition,
                self.people.gestures_of(glove.person),
                glove.responder.commands,
                answers=self.configuration.answers,
                compared=self.configuration.commands if has_condition else None,
                unavailable=state.detail if state.name == "away" else "",
            )
            return replace(spec, requires_pin=await requires_pin(job.task, job.parameters, self.broker))
        except TaskFailed as failure:
            await self._reports.cannot_be_shown(job.task.id, failure.reason)
            raise

    # Background loops

    def _adopt(self, glove: Glove) -> None:
        glove.responder.station = Station(
            partial(self._joins.person_at, glove.name), partial(self._joins.held, glove.name)
        )
        names = [self.settings.entity_id("Device", glove.name)]
        if glove.person:
            names.append(self.settings.entity_id("Person", glove.person))
        for resource in names:
            self._new_resources.put_nowait(resource)
        for job, reason in self._without_glove.items():
            if self._glove_for(job.resource) is not None:
                job.resume(reason)
        self._reports.devices.update(glove)

    async def _act_for_new_resources(self) -> None:
        while True:
            await self.act_for(await self._new_resources.get())

    async def _check_gloves(self) -> None:
        loop = asyncio.get_running_loop()
        checked_s = loop.time()
        while True:
            await asyncio.sleep(min(MAX_CHECK_INTERVAL_S, self._silence_s / 4))
            now_s = loop.time()
            if now_s - checked_s < self._silence_s / 2:  # after a longer sleep of ours, frames may be unread
                self._check_all(now_s)
            checked_s = now_s

    def _check_all(self, now_s: float) -> None:
        for glove in self.registry.known:
            glove.check_silence(now_s, self._silence_s)
            self._join_hands(glove)
        for glove in self.registry.absent(now_s):
            if self.stop_acting_for(self.settings.entity_id("Device", glove.name)):
                self.registry.forget(glove)
                self._reports.devices.forget(glove)

    async def _save_drifts(self) -> None:
        while True:
            await asyncio.sleep(SAVE_INTERVAL_S)
            await self._drifts.save()

    async def _refresh_devices(self) -> None:
        while True:
            await asyncio.sleep(DEVICE_REFRESH_INTERVAL_S)
            for glove in self.registry.known:
                self._reports.devices.update(glove, force=True)


async def _follow_requests(glove: Glove, job: Job) -> None:
    """Let a hold begin as soon as the Task may continue, while the broker is still being notified."""
    action = RequestedAction.RUN
    while True:
        action = await job.changed(since=action)
        if action is RequestedAction.RUN:
            glove.responder.listen()
        else:
            glove.responder.stop_listening()


async def _wait_or_interrupt(job: Job, other: Any) -> None:
    """Wait for `other`, or until a pause or cancellation of `job` is requested."""
    requested = asyncio.create_task(job.changed(since=RequestedAction.RUN))
    awaited = asyncio.ensure_future(other)
    try:
        await asyncio.wait({requested, awaited}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (requested, awaited):
            await _cancel(task)


async def _cancel(task: "asyncio.Future[Any]") -> None:
    task.cancel()
    await asyncio.wait({task})
