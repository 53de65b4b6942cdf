"""Background tasks of a service: started at any time, supervised, and ended with the service.

    async with BackgroundTasks("archiver") as tasks:
        tasks.start(self._archive_forever)

`asyncio.TaskGroup` owns the tasks, so none is garbage-collected while it runs and none outlives the context.
In contrast to a bare group, a failed task is logged and the others continue: a service that loses one
connection keeps its other work.
"""

import asyncio
from collections.abc import Awaitable, Callable
from typing import ParamSpec, Self

from handover.database.outage import is_outage
from handover.errors import HandoverError
from handover.runtime.retry import MAX_DELAY_S, Backoff
from handover.telemetry import get_logger

log = get_logger(__name__)

P = ParamSpec("P")


class BackgroundTasks:
    """Supervises the background tasks of `owner`; an asynchronous context manager.

    Leaving the context cancels all tasks and waits until they have ended. `on_failure` is called with the
    exception of a task that failed, after the exception was logged.
    """

    def __init__(self, owner: str, *, on_failure: Callable[[Exception], None] | None = None) -> None:
        self._owner = owner
        self._on_failure = on_failure
        self._group: asyncio.TaskGroup | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Self:
        self._group = await asyncio.TaskGroup().__aenter__()
        return self

    async def __aexit__(self, *_: object) -> None:
        group, self._group = self._group, None
        for task in self._tasks:
            task.cancel()
        if group is not None:
            await group.__aexit__(None, None, None)

    def start(
        self, function: Callable[P, Awaitable[object]], *args: P.args, **kwargs: P.kwargs
    ) -> asyncio.Task[None]:
        """Run `function` in the background and return its task, for example to cancel it.

        Outside the context the task is cancelled before its first step: a request that arrives during
        shutdown starts nothing.
        """
        work = self._supervise(function, *args, **kwargs)
        if self._group is None:
            task = asyncio.get_running_loop().create_task(work)
            task.cancel()
            return task
        task = self._group.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def start_restarting(
        self, function: Callable[P, Awaitable[object]], *args: P.args, **kwargs: P.kwargs
    ) -> asyncio.Task[None]:
        """Run `function` in the background; run it again, with backoff, when it returns or fails.

        A run that lasts longer than the maximum delay resets the backoff.
        """

        async def run_forever() -> None:
            clock = asyncio.get_running_loop().time
            backoff = Backoff()
            while True:
                started_s = clock()
                await self._supervise(function, *args, **kwargs)
                if clock() - started_s > MAX_DELAY_S:
                    backoff.reset()
                await backoff.wait()

        return self.start(run_forever)

    async def _supervise(
        self, function: Callable[P, Awaitable[object]], *args: P.args, **kwargs: P.kwargs
    ) -> None:
        try:
            await function(*args, **kwargs)
        except Exception as error:
            name = getattr(function, "__qualname__", repr(function))
            if isinstance(error, HandoverError) or is_outage(error):
                log.warning("background task failed", owner=self._owner, task=name, error=str(error))
            else:
                log.exception("background task failed", owner=self._owner, task=name)
            if self._on_failure is not None:
                self._on_failure(error)
