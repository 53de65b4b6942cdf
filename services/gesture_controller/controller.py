"""The controller: takes Tasks for gloves and for the people who wear them, and lets hands answer them."""

import asyncio
from collections.abc import Mapping
from contextlib import AsyncExitStack
from typing import Any, Self

from datamodels.states import Outcome
from handover import alert_catalogue
from handover.alerts import clear_alert, raise_alert
from handover.broker import BrokerClient
from handover.database import connect
from handover.errors import Problem
from handover.latest_value_writer import LatestValueWriter
from handover.messages import message
from handover.performer import Job, Performer, RequestedAction, TaskFailed
from handover.telemetry import get_logger
from services.gesture_controller import metrics
from services.gesture_controller.calibration.keeping import KEEP_EVERY_S, Keeping
from services.gesture_controller.calibration.logbook import Logbook
from services.gesture_controller.configuration import Configuration
from services.gesture_controller.device import Devices
from services.gesture_controller.errand import Answer, Asked, Errand
from services.gesture_controller.frames import is_glove_name
from services.gesture_controller.glove import Glove
from services.gesture_controller.glove_store import GloveStore
from services.gesture_controller.gloves import Gloves
from services.gesture_controller.inquiry import (
    definition_of,
    handles_outcomes,
    what_is_asked,
)
from services.gesture_controller.people.people import People
from services.gesture_controller.people.store import PeopleStore
from services.gesture_controller.settings import ControllerSettings
from services.gesture_controller.specifications.database import SpecificationDatabase, State

log = get_logger(__name__)

LOOK_EVERY_S = 0.1
TELL_AGAIN_S = 60.0
"""How often Device entities are written though nothing changed: somebody may have deleted them."""


class Controller(Performer):
    """Acts for every glove and its wearer; an asynchronous context manager while it is on duty."""

    def __init__(
        self, settings: ControllerSettings, configuration: Configuration, broker: BrokerClient
    ) -> None:
        super().__init__("gesture-controller", settings, broker, notify_url=settings.notify_url)
        self.configuration = configuration
        self._silence_s = settings.silence_s
        self._writer = LatestValueWriter(on_rejected=lambda _: metrics.UNTOLD.inc())
        self._patience_s = settings.specification_patience_s
        self.specifications = SpecificationDatabase(settings.specifications, self._specifications_are)
        self._devices = Devices(settings, broker, self._writer)
        self._gloveless: dict[Job, str] = {}
        """Jobs for people who wear no glove, and the reason for which each is paused."""
        self._duties = AsyncExitStack()
        self._newcomers: asyncio.Queue[str] = asyncio.Queue()
        self.database = connect(settings.database("gesture_controller"))
        store = GloveStore(self.database, settings.data_dir / "gloves")
        self.people = People(configuration, PeopleStore(self.database))
        self.gloves = Gloves(settings, store, self.people, self, self._adopt)
        self.logbook = Logbook(self.database)
        self._keeping = Keeping(self.logbook, self.gloves)

    async def __aenter__(self) -> Self:
        duties = (
            self._welcome_newcomers(),
            self._look_after_gloves(),
            self._keep_drifts(),
            self._tell_again(),
        )
        for duty in duties:
            chore = asyncio.create_task(duty)
            chore.add_done_callback(_speak_of_failure)
            self._duties.push_async_callback(_end, chore)
        await self._duties.enter_async_context(self._writer)
        return await super().__aenter__()

    async def __aexit__(self, *error: object) -> None:
        await super().__aexit__(*error)
        await self._duties.aclose()
        await self._keeping.keep(least=0.0)
        self.database.dispose()

    async def perform(self, job: Job) -> Mapping[str, Any]:
        """Ask the wearer for the gesture that the Task names, and return how it was answered."""
        glove = await self._free_glove(job)
        await self._let_wear(job, glove)
        asked = await self._find_out(job, glove)
        while (busy := self._busy(glove, asked)) is not None:
            await _change(job, busy.free.wait())
            await job.checkpoint()
        errand = Errand(asked, job, asyncio.get_running_loop().create_future())
        glove.begin(errand)
        self.gloves.equip(glove)
        self._join_hands(glove)
        try:
            answer = await self._await_answer(glove, errand)
        finally:
            glove.end()
            self.gloves.equip(glove)
        log.info(
            "task answered",
            glove=glove.name,
            gesture=answer.gesture,
            by=answer.by,
            outcome=answer.outcome.value,
        )
        if answer.outcome is Outcome.OK or await handles_outcomes(job.task, job.parameters, self.broker):
            return answer.outputs()
        raise answer.failure()

    async def _free_glove(self, job: Job) -> Glove:
        """Return the glove to ask with, once it is free; the Task is paused while its person wears none."""
        while True:
            glove = self._glove_for(job.resource)
            if glove is None:
                self._gloveless[job] = f"{job.resource.rsplit(':', 1)[-1]} wears no glove"
                job.pause(self._gloveless[job])
                try:
                    await job.checkpoint()
                finally:
                    job.resume(self._gloveless.pop(job, ""))
            elif glove.errand is None:
                return glove
            else:
                await _change(job, glove.free.wait())
                await job.checkpoint()

    def _glove_for(self, resource: str) -> Glove | None:
        for glove in self.gloves:
            if self.settings.entity_id("Device", glove.name) == resource:
                return glove
        person = self._person_of(resource)
        return next(iter(self.gloves.worn_by(person)), None)

    def _person_of(self, resource: str) -> str | None:
        """Return the name of a Person of this factory."""
        name = resource.rsplit(":", 1)[-1]
        return name if self.settings.entity_id("Person", name) == resource else None

    async def _let_wear(self, job: Job, glove: Glove) -> None:
        """Take the Person that a Task for a glove involves for its wearer."""
        if job.resource != self.settings.entity_id("Device", glove.name):
            return
        for link in job.task.involves or ():
            person = self._person_of(link.object)
            if person is not None and is_glove_name(person):
                try:
                    await self.gloves.wear(glove, person)
                except Problem as problem:
                    log.warning("who wears the glove could not be kept", glove=glove.name, error=str(problem))
                return

    def _busy(self, glove: Glove, asked: Asked) -> Glove | None:
        """Return a glove that must be free before it can be `asked`, and is not."""
        partner = self.gloves.partner_of(glove) if asked.hands == "both" else None
        return next((one for one in (glove, partner) if one is not None and one.errand is not None), None)

    def _join_hands(self, glove: Glove) -> None:
        """Let the other hand take part where both are asked for, as soon as its glove is there and free."""
        if glove.errand is None or glove.partner is not None or glove.errand.asked.hands == "one":
            return
        partner = self.gloves.partner_of(glove)
        if partner is not None and partner.errand is None:
            glove.join(partner)
            self.gloves.equip(partner)

    async def _await_answer(self, glove: Glove, errand: Errand) -> Answer:
        following = asyncio.create_task(_follow_wishes(glove, errand.job))
        try:
            while not errand.answer.done():
                await errand.job.checkpoint()
                glove.listen()
                await _change(errand.job, asyncio.wait({errand.answer}))
        finally:
            await _end(following)
        return errand.answer.result()

    async def _find_out(self, job: Job, glove: Glove) -> Asked:
        definition = await definition_of(
            job.task, job.parameters, self.broker, self.specifications, self._patience_s
        )
        state = self.specifications.state
        try:
            return what_is_asked(
                job.task,
                job.parameters,
                definition,
                self.people.gestures_of(glove.person),
                glove.commands,
                answers=self.configuration.answers,
                compared=self.configuration.commands if self.gloves.condition_of(glove) else None,
                lacking=state.detail if state.name == "away" else "",
            )
        except TaskFailed as failure:
            self._alert_of_wrong_task(job, failure.reason)
            raise

    def _alert_of_wrong_task(self, job: Job, reason: str) -> None:
        task_id = job.task.id
        self._writer.put(
            f"Alert {task_id}",
            lambda: raise_alert(
                self.broker,
                self.settings,
                alert_catalogue.UNKNOWN_GESTURE,
                key=f"{task_id.rsplit(':', 1)[-1]} cannot be shown",
                source=task_id,
                description=reason,
            ),
        )

    def _specifications_are(self, state: State) -> None:
        """Raise an Alert while the specification database is away, and say when that is over."""
        key = "specification database away"
        if state.name == "away":
            self._writer.put(
                "Alert specifications",
                lambda: raise_alert(
                    self.broker,
                    self.settings,
                    alert_catalogue.SPECIFICATIONS_UNAVAILABLE,
                    key=key,
                    source=self.settings.entity_id("Device", "specification-database"),
                    description=message(
                        "alert.specifications_away",
                        "{detail}. Only Tasks that say all themselves can be shown",
                        detail=state.detail,
                    ),
                ),
            )
        else:
            self._writer.put("Alert specifications", lambda: clear_alert(self.broker, self.settings, key=key))

    # What gloves tell

    def state_changed(self, glove: Glove) -> None:
        """Have its Device entity written."""
        self._devices.tell(glove)

    def went_silent(self, glove: Glove) -> None:
        """Raise an Alert: a Task waits for a glove that does not send."""
        log.warning("glove went silent in the middle of a task", glove=glove.name)
        description = message(
            "alert.glove_silent",
            "{glove} has sent nothing for {seconds} s in the middle of a Task, which is paused until it is "
            "back; check that it is switched on, charged and near, or complete the Task on the screen",
            glove=glove.name,
            seconds=f"{self._silence_s:g}",
        )
        self._writer.put(
            f"Alert {glove.name} silent",
            lambda: raise_alert(
                self.broker,
                self.settings,
                alert_catalogue.GLOVE_SILENT,
                key=_silence_key(glove),
                source=self._devices.id_of(glove),
                description=description,
            ),
        )

    def came_back(self, glove: Glove) -> None:
        """Say that the Alert of its silence is over, an earlier run's too."""
        log.info("glove sends", glove=glove.name)
        self._writer.put(
            f"Alert {glove.name} silent",
            lambda: clear_alert(self.broker, self.settings, key=_silence_key(glove)),
        )

    def fits_badly(self, glove: Glove, why: str) -> None:
        """Raise an Alert: the glove should be calibrated again."""
        log.warning("glove should be calibrated again", glove=glove.name, why=why)
        description = message(
            "alert.calibration_needed",
            "{glove} should be calibrated again: {why}. Put it on as usual, make a fist and open the hand on "
            "the page Calibrate; Tasks can be completed on the screen meanwhile",
            glove=glove.name,
            why=why,
        )
        self._writer.put(
            f"Alert {glove.name} fit",
            lambda: raise_alert(
                self.broker,
                self.settings,
                alert_catalogue.CALIBRATION_NEEDED,
                key=_fit_key(glove),
                source=self._devices.id_of(glove),
                description=description,
            ),
        )

    def fits_again(self, glove: Glove) -> None:
        """Say that the Alert of its fit is over."""
        self._writer.put(
            f"Alert {glove.name} fit",
            lambda: clear_alert(self.broker, self.settings, key=_fit_key(glove)),
        )

    # Duties

    def _adopt(self, glove: Glove) -> None:
        names = [self.settings.entity_id("Device", glove.name)]
        if glove.person:
            names.append(self.settings.entity_id("Person", glove.person))
        for resource in names:
            self._newcomers.put_nowait(resource)
        for job, reason in self._gloveless.items():
            if self._glove_for(job.resource) is not None:
                job.resume(reason)
        self._devices.tell(glove)

    async def _welcome_newcomers(self) -> None:
        while True:
            await self.act_for(await self._newcomers.get())

    async def _look_after_gloves(self) -> None:
        loop = asyncio.get_running_loop()
        looked_s = loop.time()
        while True:
            await asyncio.sleep(min(LOOK_EVERY_S, self._silence_s / 4))
            now_s = loop.time()
            if now_s - looked_s < self._silence_s / 2:  # else it was us who slept: frames may lie in the line
                for glove in self.gloves:
                    glove.look_after(now_s, self._silence_s)
                    self._join_hands(glove)
                for glove in self.gloves.absent(now_s):
                    if self.stop_acting_for(self.settings.entity_id("Device", glove.name)):
                        self.gloves.forget(glove)
                        self._devices.forget(glove)
            looked_s = now_s

    async def _keep_drifts(self) -> None:
        while True:
            await asyncio.sleep(KEEP_EVERY_S)
            await self._keeping.keep()

    async def _tell_again(self) -> None:
        while True:
            await asyncio.sleep(TELL_AGAIN_S)
            for glove in self.gloves:
                self._devices.tell(glove, again=True)


def _fit_key(glove: Glove) -> str:
    return f"{glove.name} fit"


def _silence_key(glove: Glove) -> str:
    return f"{glove.name} silent"


async def _follow_wishes(glove: Glove, job: Job) -> None:
    """Let a hold begin as soon as the work may go on, while that is still being reported."""
    while True:
        if await job.changed() is RequestedAction.RUN:
            glove.listen()
        else:
            glove.rest()


async def _change(job: Job, other: Any) -> None:
    """Wait until `other` has happened, or until something else is wished of `job` than to go on."""
    wishes = asyncio.create_task(job.changed(since=RequestedAction.RUN))
    happens = asyncio.ensure_future(other)
    try:
        await asyncio.wait({wishes, happens}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for waiting in (wishes, happens):
            await _end(waiting)


async def _end(chore: "asyncio.Future[Any]") -> None:
    chore.cancel()
    await asyncio.wait({chore})


def _speak_of_failure(chore: "asyncio.Future[Any]") -> None:
    if not chore.cancelled() and (error := chore.exception()) is not None:
        log.error("a duty of the gesture controller failed", exc_info=error)
