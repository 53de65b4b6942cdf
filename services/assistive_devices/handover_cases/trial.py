"""A trial: the script of a case, which waits for conditions and compares figures with those of the paper."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

from handover.errors import Problem
from handover.messages import message

POLL_S: Final = 0.05
RETRY_S: Final = 0.5

HEART_RATE_IS_VALID: Final = message("case.wait.heart_rate", "a valid heart rate")
BODY_IS_CALM: Final = message("case.wait.calm", "the limit of a calm body")
LIMIT_FALLS: Final = message("case.wait.limit_falls", "the limit falls")
TIME_IS_OVER: Final = message("case.wait.end", "the end")
NOT_IN_PAPER: Final = message("case.paper.absent", "(not in the paper)")
STOPPED_BY_PERSON: Final = message("case.stopped_by_person", "a person stopped the machine")


class TrialFailed(Exception):
    """A condition of a trial did not come true; the text names it."""


def _late(what: str, timeout_s: float) -> TrialFailed:
    return TrialFailed(
        message("case.late", "{what}: not within {seconds} s", what=what, seconds=round(timeout_s))
    )


@dataclass(frozen=True, slots=True)
class Figure:
    """One line of the comparison, in texts or messages; `passed` is None where nothing is to be decided."""

    name: str
    paper: str
    ours: str
    passed: bool | None = None


@dataclass(slots=True)
class Trial:
    """The course of a trial. `duration_s` is how long the machine is used; the paper's by default.

    `consents_to_model`: the simulated person consents that a language model words what the machine says.
    """

    duration_s: float | None = None
    consents_to_model: bool = False
    began_s: float = field(default_factory=time.monotonic)
    messages: list[tuple[float, str]] = field(default_factory=list)
    """The time since the beginning in s, and what happened."""
    figures: list[Figure] = field(default_factory=list)
    failure: str = ""
    is_running: bool = True
    on_reset: Callable[[], Awaitable[object]] | None = None
    """Releases a stop of the limit, as the person in charge does."""

    is_permitted: Callable[[], bool] = lambda: True
    """Whether the limit lets the machine move."""

    async def permission(self, timeout_s: float) -> None:
        """Wait until the limit lets the machine move; the person in charge releases a stop before the begin.

        A limit is 0 until human state has received a heart rate, which may take long on a slow machine.
        """
        began_s = time.monotonic()
        while not self.is_permitted():
            if time.monotonic() - began_s > timeout_s:
                raise _late(message("case.wait.permission", "the limit lets the machine move"), timeout_s)
            with suppress(Problem):
                await self.reset()
            await asyncio.sleep(RETRY_S)

    async def calm(self, what: str, condition: Callable[[], bool], timeout_s: float) -> None:
        """Wait as `until` does, for what a calm body allows; the person in charge releases stops meanwhile.

        On a machine that stands still for seconds, the limit ages and stops: that is right, and no failure.
        """
        began_s = time.monotonic()
        while not condition():
            left_s = timeout_s - (time.monotonic() - began_s)
            if left_s <= 0:
                raise _late(what, timeout_s)
            await self.permission(left_s)
            await asyncio.sleep(RETRY_S)

    async def reset(self) -> None:
        """Let the person in charge release a stop of the limit."""
        if self.on_reset is not None:
            await self.on_reset()

    @property
    def passed(self) -> bool:
        """Return whether the machine did what it should."""
        return (
            not self.is_running
            and not self.failure
            and all(figure.passed is not False for figure in self.figures)
        )

    @property
    def elapsed_s(self) -> float:
        """Return the time since the beginning."""
        return time.monotonic() - self.began_s

    def say(self, text: str) -> None:
        """Note what happens, for people: a message, so that they read it in their language."""
        self.messages.append((self.elapsed_s, text))

    def compare(self, name: str, paper: str, ours: str, passed: bool | None = None) -> None:
        """Add a figure of the paper with ours."""
        self.figures.append(Figure(name, paper, ours, passed))

    async def until(self, what: str, condition: Callable[[], bool], timeout_s: float) -> float:
        """Wait until `condition` holds; return the seconds. Raises `TrialFailed` after `timeout_s`."""
        began_s = time.monotonic()
        while not condition():
            if time.monotonic() - began_s > timeout_s:
                raise _late(what, timeout_s)
            await asyncio.sleep(POLL_S)
        return time.monotonic() - began_s

    async def holds(self, what: str, condition: Callable[[], bool], for_s: float) -> None:
        """Wait `for_s` while `condition` holds. Raises `TrialFailed` when it does not."""
        began_s = time.monotonic()
        while time.monotonic() - began_s < for_s:
            if not condition():
                held_s = round(time.monotonic() - began_s, 1)
                raise TrialFailed(
                    message("case.ended", "{what}: not any more after {seconds} s", what=what, seconds=held_s)
                )
            await asyncio.sleep(POLL_S)
