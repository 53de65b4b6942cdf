"""The controllers: one performer for each robot of the cell. Each executes Tasks one after another."""

import asyncio
import os
import time
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from typing import Any, Self

from fastapi import FastAPI

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.messages import message, text_of
from handover.performer import Job, Performer, RequestedAction, TaskCancelled, TaskFailed, TaskGone
from handover.runtime.background_tasks import BackgroundTasks
from handover.runtime.retry import Backoff, retry
from handover.settings import RESTARTED
from handover.subscriptions.record import SubscriptionRecord
from handover.tasks.outcomes import outcome_unknown
from handover.tasks.task_life import type_of
from handover.telemetry import get_logger
from handover_datamodels.entities import DeviceState
from handover_robots.cell.cell import RobotCell
from handover_robots.cell.device import RobotDevice
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.limits.records import LimitRecords
from handover_robots.metrics import TASKS
from handover_robots.model.faults import RobotFault, UnknownOutcome
from handover_robots.people.entities import PersonEntities
from handover_robots.scene.scene_entities import SceneEntities
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks import operations, parameters
from handover_robots.tasks.work import Work

log = get_logger(__name__)

PROGRESS_EVERY_S = 0.25
SWITCH_ON_RETRY_S, MAX_SWITCH_ON_RETRY_S = 2.0, 30.0
PICK_TARGETS = frozenset({"part", "pose", "bin"})
"""Parameters of which each says what a pick grips."""


class Controllers:
    """The performers of all robots in the cell; an asynchronous context manager while they are active.

    Raises `UsageError` when a robot, the scene or the stored state is invalid.
    """

    def __init__(self, settings: TrajectorySettings, broker: BrokerClient) -> None:
        self.cell = RobotCell(settings, broker=broker)
        self._broker = broker
        self._record = SubscriptionRecord(settings.data_dir / "trajectory_tool" / "subscriptions.json")
        self.by_name = {
            name: Controller(settings, unit, broker, self._record) for name, unit in self.cell.units.items()
        }
        self._subscription_ids = {
            *(controller.subscription_id for controller in self.by_name.values()),
            *(
                subscription_id
                for unit in self.cell.units.values()
                for subscription_id in unit.robot.record_subscriptions(self._record)
            ),
        }
        self._scene = SceneEntities(settings, broker)
        self._people = PersonEntities(broker, self.cell.receive_people) if settings.people_entities else None
        self._on = AsyncExitStack()

    def mount(self, app: FastAPI) -> None:
        """Add the routes for notifications."""
        for controller in self.by_name.values():
            controller.mount(app)

    def of(self, robot: str) -> "Controller | None":
        """Return the controller of a robot by its name or the id of its Device."""
        matches = (
            controller
            for controller in self.by_name.values()
            if robot in {controller.robot_name, controller.device.id}
        )
        return next(matches, None)

    async def probe(self) -> None:
        """Raise `BrokerUnavailable` while a subscription to Tasks is missing."""
        for controller in self.by_name.values():
            await controller.probe()

    async def __aenter__(self) -> Self:
        cell = self.cell
        await self._on.enter_async_context(self._scene)
        cell.on_scene_change = lambda: self._scene.put(cell.scene, cell.revision)
        cell.on_scene_change()
        for controller in self.by_name.values():
            await self._on.enter_async_context(controller)
        tasks = await self._on.enter_async_context(BackgroundTasks("trajectory tool"))
        tasks.start(self._delete_unused_subscriptions)
        if self._people is not None:
            tasks.start(self._people.run)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._on.aclose()

    async def _delete_unused_subscriptions(self) -> None:
        """Delete the subscriptions of robots that are no longer in the cell file."""
        try:
            await retry(
                lambda: self._record.delete_others(self._broker, self._subscription_ids), on=BrokerUnavailable
            )
        except BrokerError as error:
            log.warning("unused subscriptions stay until the next start", error=str(error))


class Controller(Performer):
    """The performer of one robot.

    A robot that cannot be switched on is tried again, and its Tasks fail meanwhile; other robots work.
    """

    def __init__(
        self,
        settings: TrajectorySettings,
        unit: RobotUnit,
        broker: BrokerClient,
        subscription_record: SubscriptionRecord,
    ) -> None:
        super().__init__(
            f"trajectory-tool-{unit.name}",
            settings,
            broker,
            notify_url=f"{settings.notify_url}/{unit.name}",
            subscription_record=subscription_record,
        )
        self.robot_name = unit.name
        self.unit = unit
        self.work: Work | None = None
        self.device = RobotDevice(settings, self.unit, broker)
        self._records = LimitRecords(settings, unit.speed, self.device.id, broker)
        self._on = AsyncExitStack()
        self._fault: RobotFault | None = None
        self._switching_on: asyncio.Task[None] | None = None

    def mount(self, app: FastAPI) -> None:
        """Add the routes for notifications."""
        super().mount(app)
        self.unit.robot.mount(app)

    async def __aenter__(self) -> Self:
        self.unit.robot.lease = self.leases.of(self.device.id)
        await self._on.enter_async_context(self.device)
        await self._on.enter_async_context(self._records)
        await self._try_switch_on()
        if self._fault is not None:
            self._switching_on = asyncio.create_task(self._keep_switching_on())
        await self.act_for(self.device.id)
        return await super().__aenter__()

    async def __aexit__(self, *_: object) -> None:
        await super().__aexit__(*_)
        if self._switching_on is not None:
            self._switching_on.cancel()
            await asyncio.wait([self._switching_on])
        await self._on.aclose()

    async def _try_switch_on(self) -> None:
        try:
            await self._on.enter_async_context(self.unit)
        except RobotFault as fault:
            log.warning("robot not switched on", robot=self.robot_name, fault=str(fault))
            self._fault = fault
            self.device.set_state(DeviceState.ERROR)
        else:
            self._fault = None

    async def _keep_switching_on(self) -> None:
        backoff = Backoff(SWITCH_ON_RETRY_S, MAX_SWITCH_ON_RETRY_S)
        while self._fault is not None:
            await backoff.wait()
            await self._try_switch_on()
        self.device.set_state(DeviceState.IDLE)

    async def may_repeat(self, job: Job) -> bool:
        """Return whether an operation continues: this cell knows its gripper's acts; targets are absolute."""
        return job.begun_here

    async def perform(self, job: Job) -> Mapping[str, Any]:
        """Execute the operation of the Task and return its result."""
        name = _operation_of(job)
        began_s = time.monotonic()
        with _counted(name), self._device_state():
            if self._fault is not None:
                raise self._fault
            if job.resumed and os.environ.get(RESTARTED):
                raise TaskFailed(
                    outcome_unknown(
                        message(
                            "robot.tool_restarted",
                            "the trajectory tool did not answer and was restarted; look at the robot, then "
                            "repeat the task or skip it",
                        )
                    )
                )
            operation = operations.operation_named(name)
            values = parameters.read(operation.parameters, name, _parameters_of(job, name))
            speed = self.unit.entry.speed * values.speed
            steering, involves = _Steering(job, self.device), _involved(job)
            self.work = work = Work(job.task.id, name, self.unit, steering, speed, involves=involves)
            log.info("robot starts", task=job.task.id, operation=name, again=job.resumed)
            async with self.unit.in_hand, _progress_reports(job, work):
                result = await operation.perform(work, values)
        return {**result, "durationS": round(time.monotonic() - began_s, 2), "progress": 1.0}

    @contextmanager
    def _device_state(self) -> Iterator[None]:
        """Write the Device's state during and after the work."""
        self.device.set_state(DeviceState.BUSY)
        after = DeviceState.IDLE
        try:
            yield
        except UnknownOutcome as fault:
            after = DeviceState.ERROR
            raise TaskFailed(outcome_unknown(text_of(fault))) from fault
        except RobotFault as fault:
            after = DeviceState.ERROR
            raise TaskFailed.translated(
                "robot.cannot_move", "the robot cannot move: {fault}", fault=text_of(fault)
            ) from fault
        except OSError as error:
            raise TaskFailed.translated(
                "robot.state_not_stored",
                "the state of the cell cannot be stored in {path}: {error}; free disk space or set "
                "HANDOVER_DATA_DIR",
                path=str(self.unit.file.path),
                error=error.strerror,
            ) from error
        finally:
            self.work = None
            self.device.set_state(after)


class _Steering:
    """Pauses or ends the work as the Task's requested action demands."""

    def __init__(self, job: Job, device: RobotDevice) -> None:
        self._job = job
        self._device = device

    def may_go(self) -> bool:
        return self._job.may_continue()

    async def rest(self) -> None:
        if self._job.requested_action is RequestedAction.PAUSE:
            self._device.set_state(DeviceState.PAUSED)
        await self._job.checkpoint()
        self._device.set_state(DeviceState.BUSY)


def _operation_of(job: Job) -> str:
    named = job.parameters.get("operation")
    return str(named) if named is not None else job.task.is_defined_by.object.rsplit(":", 1)[-1]


def _involved(job: Job) -> list[str]:
    return [link.object for link in job.task.involves or ()]


def _parameters_of(job: Job, operation: str) -> Mapping[str, Any]:
    """Return the workParameters; a pick without a target takes the only Material of the Task as its part."""
    values = job.parameters
    if operation != "pick" or PICK_TARGETS & values.keys():
        return values
    materials = [entity_id for entity_id in _involved(job) if type_of(entity_id) == "Material"]
    return {**values, "part": materials[0]} if len(materials) == 1 else values


@asynccontextmanager
async def _progress_reports(job: Job, work: Work) -> AsyncIterator[None]:
    async def report() -> None:
        while True:
            job.report_progress(work.progress())
            await asyncio.sleep(PROGRESS_EVERY_S)

    async with BackgroundTasks("progress reports") as tasks:
        tasks.start(report)
        yield


@contextmanager
def _counted(name: str) -> Iterator[None]:
    outcome = "completed"
    try:
        yield
    except TaskGone:
        outcome = "gone"
        raise
    except TaskCancelled:
        outcome = "cancelled"
        raise
    except asyncio.CancelledError:
        outcome = "interrupted"
        raise
    except Exception:
        outcome = "failed"
        raise
    finally:
        TASKS.labels(name if name in operations.OPERATIONS else "unknown", outcome).inc()
