"""Offload: runs a function in a separate Python process.

Work that grows with its input must not run on the event loop, and a thread is not enough: threads share
the interpreter lock, and extensions such as a YAML or statistics library hold it throughout. So the function
and its arguments are pickled to a new process, and its result or exception is pickled back. The process ends
with its work; after a timeout it is killed. Starting it takes up to a second, so small inputs are better
processed directly.
"""

import asyncio
import importlib
import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any, ParamSpec, TypeVar

from handover.errors import HandoverError
from handover.runtime.python_processes import code_command

DEFAULT_TIMEOUT_S = 60.0
_CHILD = "from handover.runtime.offload import _main; _main()"

P = ParamSpec("P")
R = TypeVar("R")


class OffloadFailed(HandoverError):
    """The process ended without a result: it took too long, or the system ended it."""


class Offload:
    """Runs functions in separate processes, at most `max_processes` at the same time."""

    def __init__(self, max_processes: int = 1, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        self._slots = asyncio.Semaphore(max_processes)
        self._timeout_s = timeout_s

    async def run(self, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Return the result of `function` or raise its exception; `OffloadFailed` if it has neither.

        `function` is a top-level function; its arguments, result and exceptions can be pickled.
        """
        request = pickle.dumps((function.__module__, function.__qualname__, args, kwargs))
        async with self._slots:
            answer = await self._answer(request, function.__qualname__)
        succeeded, value = pickle.loads(answer)  # noqa: S301 - our own process wrote it
        if not succeeded:
            raise value
        result: R = value
        return result

    async def _answer(self, request: bytes, name: str) -> bytes:
        process = await asyncio.create_subprocess_exec(
            *code_command(_CHILD),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)},
        )
        try:
            async with asyncio.timeout(self._timeout_s):
                answer, _ = await process.communicate(request)
        except TimeoutError:
            raise OffloadFailed(f"{name} took longer than {self._timeout_s:g} s") from None
        finally:
            if process.returncode is None:
                with suppress(ProcessLookupError):
                    process.kill()
                await process.wait()
        if process.returncode != 0:
            raise OffloadFailed(f"{name} ended with the exit code {process.returncode}")
        return answer


def _main() -> None:
    """Answer the request on standard input; output of the function goes to standard error."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    module, qualname, args, kwargs = pickle.load(sys.stdin.buffer)  # noqa: S301 - our own parent wrote it
    try:
        function: Any = importlib.import_module(module)
        for name in qualname.split("."):
            function = getattr(function, name)
        answer = pickle.dumps((True, function(*args, **kwargs)))
    except Exception as error:  # noqa: BLE001 - it is raised again in the process that asked
        try:
            answer = pickle.dumps((False, error))
            pickle.loads(answer)  # noqa: S301 - an exception of several arguments may not come back
        except Exception:  # noqa: BLE001
            answer = pickle.dumps((False, OffloadFailed(f"{type(error).__name__}: {error}")))
    with answers:
        answers.write(answer)
