"""Tasks of the humanoid: `juggle` and `walkAssisted` are sessions, with their figures in outputParameters.

A pause or a cancellation lets the robot finish its step and stand. A session that pauses by itself, such as
for a headset that is silent, pauses its Task; a person resumes the session. One that a speed limit ends
completes its Task, with `endedBy` "limit", so that the process decides how to go on.
"""

import asyncio
from collections.abc import Mapping
from typing import Any, Final

from pydantic import ValidationError

from handover.broker import BrokerClient
from handover.errors import Problem
from handover.formats.validation import fault_text
from handover.messages import message
from handover.performer import Job, Performer, RequestedAction, TaskFailed
from handover_humanoid.running.humanoid_control import HumanoidControl
from handover_humanoid.running.sessions.plans import JuggleParameters, WalkParameters, plan_of
from handover_humanoid.running.sessions.training import Session, Training
from handover_humanoid.running.sessions.writer import SessionWriter
from handover_humanoid.sessions.exercise import EndReason, PauseReason, SessionError, State
from handover_humanoid.settings import WholeBodySettings

POLL_S: Final = 0.1
HOLD: Final = "the session is paused"
_NOT_PARAMETERS: Final = frozenset({"operation", "description"})
_PARAMETERS: Final[Mapping[str, type[JuggleParameters | WalkParameters]]] = {
    "juggle": JuggleParameters,
    "walkAssisted": WalkParameters,
}


class HumanoidTasks(Performer):
    """Performs the Tasks of the humanoid, one at a time."""

    def __init__(
        self,
        settings: WholeBodySettings,
        control: HumanoidControl,
        training: Training,
        writer: SessionWriter,
        broker: BrokerClient,
    ) -> None:
        super().__init__(
            "whole-body-control", settings, broker, notify_url=f"{settings.whole_body}/notifications"
        )
        self._control, self._training, self._writer = control, training, writer

    async def perform(self, job: Job) -> Mapping[str, Any]:
        """Perform the session of a Task."""
        operation = str(job.parameters.get("operation") or job.task.is_defined_by.object.rpartition(":")[2])
        parameters = _PARAMETERS.get(operation)
        if parameters is None:
            raise TaskFailed.translated(
                "humanoid.no_such_operation",
                'the humanoid has no operation "{operation}"; it has: {known}',
                operation=operation,
                known=", ".join(_PARAMETERS),
            )
        wanted = {name: value for name, value in job.parameters.items() if name not in _NOT_PARAMETERS}
        try:
            plan = plan_of(parameters.model_validate(wanted), self.settings, task=job.task.id)
            session = await self._writer.begin(plan)
        except ValidationError as error:
            raise TaskFailed(fault_text(error, "parameters")) from None
        except Problem as problem:
            raise TaskFailed(problem.detail) from None
        try:
            await self._follow(job, session)
        finally:
            self._training.end(EndReason.CANCELLED)
            await self._writer.flush()
        return self._result(session)

    async def _follow(self, job: Job, session: Session) -> None:
        """Return at the end of the session, when the robot stands."""
        while not session.is_ended:
            job.report_progress(session.view()["progress"], **_outputs(session))
            if job.requested_action is RequestedAction.CANCEL:
                self._training.end(EndReason.CANCELLED)
            elif job.requested_action is RequestedAction.PAUSE:
                await self._rest(job)
            elif session.exercise.state is State.PAUSED:
                await self._await_resumption(job, session)
            await asyncio.sleep(POLL_S)
        await self._stand()
        await job.checkpoint()  # raises for a cancelled Task

    async def _rest(self, job: Job) -> None:
        """Pause the session for its Task until the Task continues."""
        self._training.pause()
        await self._stand()
        await job.checkpoint()
        try:
            self._training.resume()
        except SessionError:
            return  # it stays paused for a cause of its own

    async def _await_resumption(self, job: Job, session: Session) -> None:
        """Report the Task paused while the session is; it continues when a person resumes the session."""
        await self._stand()
        reason = f"{HOLD}: {session.view()['pauseReason'] or PauseReason.PERSON}"
        job.pause(reason)
        reporting = asyncio.create_task(job.checkpoint())
        try:
            while session.exercise.state is State.PAUSED and not reporting.done():  # noqa: ASYNC110
                await asyncio.sleep(POLL_S)
        finally:
            job.resume(reason)
            await asyncio.wait([reporting])
        reporting.result()

    async def _stand(self) -> None:
        while self._control.links.is_live and not self._control.is_standing:  # noqa: ASYNC110 - a robot
            await asyncio.sleep(POLL_S)

    def _result(self, session: Session) -> Mapping[str, Any]:
        outputs = _outputs(session)
        if session.exercise.ended_by is EndReason.FAULT:
            raise TaskFailed(
                message("humanoid.session_fault", "the humanoid could not continue the session"), **outputs
            )
        return outputs


def _outputs(session: Session) -> dict[str, Any]:
    view = session.view()
    names = ("exercisedS", "score", "throws", "caught", "level", "distanceM", "endedBy")
    return {"session": session.id, **{name: view[name] for name in names}}
