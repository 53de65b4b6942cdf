"""The controller: the performer of the robot. It executes Tasks one after another."""

import asyncio
import time
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from typing import Any, Self

from fastapi import FastAPI

from datamodels.entities import DeviceState
from handover.background_tasks import BackgroundTasks
from handover.broker import BrokerClient
from handover.messages import message, text_of
from handover.performer import Job, Performer, RequestedAction, TaskCancelled, TaskFailed, TaskGone
from handover.task_life import type_of
from handover.telemetry import get_logger
from services.trajectory_tool import operations, parameters
from services.trajectory_tool.cell import Cell
from services.trajectory_tool.device import RobotDevice
from services.trajectory_tool.metrics import TASKS
from services.trajectory_tool.robot import RobotFault
from services.trajectory_tool.settings import TrajectorySettings
from services.trajectory_tool.work import Work

log = get_logger(__name__)

PROGRESS_EVERY_S = 0.25
PICK_TARGETS = frozenset({"part", "pose", "bin"})
"""Parameters of which each says what a pick grips."""


class Controller(Performer):
    """The performer of one robot. Raises `UsageError` when robot, scene or stored state is invalid."""

    def __init__(self, settings: TrajectorySettings, broker: BrokerClient) -> None:
        super().__init__(
            f"trajectory-tool-{settings.robot_id}", settings, broker, notify_url=settings.notify_url
        )
        self.robot_name = settings.robot_id
        self.cell = Cell(settings, broker=broker)
        self.work: Work | None = None
        self._speed = settings.robot_speed
        self._on = AsyncExitStack()
        self.device = RobotDevice(settings, self.cell, broker)

    def mount(self, app: FastAPI) -> None:
        """Add the routes for notifications."""
        super().mount(app)
        self.cell.robot.mount(app)

    async def __aenter__(self) -> Self:
        await self._on.enter_async_context(self.cell)
        await self._on.enter_async_context(self.device)
        await self.act_for(self.device.id)
        return await super().__aenter__()

    async def __aexit__(self, *_: object) -> None:
        await super().__aexit__(*_)
        await self._on.aclose()

    async def perform(self, job: Job) -> Mapping[str, Any]:
        """Execute the operation of the Task and return its result."""
        name = _operation_of(job)
        began_s = time.monotonic()
        with _counted(name), self._device_state():
            operation = operations.known(name)
            values = parameters.read(operation.parameters, name, _parameters_of(job, name))
            speed = self._speed * values.speed
            self.work = work = Work(job.task.id, name, self.cell, _Steering(job, self.device), speed)
            log.info("robot starts", task=job.task.id, operation=name, again=job.resumed)
            async with self.cell.in_hand, _progress_reports(job, work):
                result = await operation.perform(work, values)
        return {**result, "durationS": round(time.monotonic() - began_s, 2), "progress": 1.0}

    @contextmanager
    def _device_state(self) -> Iterator[None]:
        """Write the Device's state during and after the work."""
        self.device.set_state(DeviceState.BUSY)
        after = DeviceState.IDLE
        try:
            yield
        except RobotFault as fault:
            after = DeviceState.ERROR
            raise TaskFailed(
                message("robot.cannot_move", "the robot cannot move: {fault}", fault=text_of(fault))
            ) from fault
        except OSError as error:
            raise TaskFailed(
                message(
                    "robot.state_not_stored",
                    "the state of the cell cannot be stored in {path}: {error}; free disk space or set "
                    "HANDOVER_DATA_DIR",
                    path=str(self.cell.file.path),
                    error=error.strerror,
                )
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
        return self._job.requested_action is RequestedAction.RUN

    async def rest(self) -> None:
        if self._job.requested_action is RequestedAction.PAUSE:
            self._device.set_state(DeviceState.PAUSED)
        await self._job.checkpoint()
        self._device.set_state(DeviceState.BUSY)


def _operation_of(job: Job) -> str:
    named = job.parameters.get("operation")
    return str(named) if named is not None else job.task.is_defined_by.object.rsplit(":", 1)[-1]


def _parameters_of(job: Job, operation: str) -> Mapping[str, Any]:
    """Return the workParameters; a pick without a target takes the only Material of the Task as its part."""
    values = job.parameters
    if operation != "pick" or PICK_TARGETS & values.keys():
        return values
    involved = (link.object for link in job.task.involves or ())
    materials = [each for each in involved if type_of(each) == "Material"]
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
