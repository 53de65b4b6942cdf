"""A command, and what happens to it next: pure functions with the time as an argument.

A command must not be executed twice, and a motion must not begin late. So it depends on its kind whether it
waits for the device, and whether it is sent again:

| kind    | device away           | no answer  | new connection, same run | new run of the program          |
|---------|-----------------------|------------|--------------------------|---------------------------------|
| motion  | refused               | sent once  | sent once                | ends as unknown                 |
| action  | queued until deadline | sent again | sent again               | ends as unknown, if it was sent |
| setting | queued until deadline | sent again | sent again               | sent again                      |

Sending again has the same id. A device remembers the ids of its run (`boot` in its hello) and answers a known
one with its last answer. A new run has forgotten them, so an action that an earlier run received may have
been executed: nobody knows, and it is not repeated.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum, StrEnum
from typing import Any, Final

from handover_devices.model.description import CommandKind
from handover_devices.protocol.messages import AnswerState, CommandAnswer

MAX_RESEND_FACTOR: Final = 16.0


class CommandState(StrEnum):
    """The state of a command; the last five are final."""

    QUEUED = "queued"
    SENT = "sent"
    ACCEPTED = "accepted"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"
    EXPIRED = "expired"
    UNKNOWN = "unknown"


OPEN: Final = frozenset({CommandState.QUEUED, CommandState.SENT, CommandState.ACCEPTED, CommandState.RUNNING})


@dataclass(frozen=True, slots=True)
class Command:
    """A command; `boot` is the run of the device's program that it was sent to, None before that."""

    device: str
    id: str
    name: str
    kind: CommandKind
    parameters: Mapping[str, Any]
    created_s: float
    deadline_s: float
    state: CommandState = CommandState.QUEUED
    progress: float | None = None
    result: Mapping[str, Any] | None = None
    reason: str | None = None
    boot: str | None = None

    @property
    def is_open(self) -> bool:
        """Whether the command has not ended."""
        return self.state in OPEN

    def sent_to(self, boot: str) -> "Command":
        """Return the command after it was sent to a run of the device's program."""
        state = CommandState.SENT if self.state is CommandState.QUEUED else self.state
        return replace(self, state=state, boot=boot)

    def ended(self, state: CommandState, reason: str) -> "Command":
        """Return the command after it has ended; unchanged if it had ended before."""
        return replace(self, state=state, reason=reason) if self.is_open else self


class Step(Enum):
    """What the gateway does with a command now."""

    WAIT = "wait"
    SEND = "send"
    EXPIRE = "expire"
    GIVE_UP = "give up"


@dataclass(frozen=True, slots=True)
class Sent:
    """How often a command was sent over the present connection, and when last."""

    times: int = 0
    at_s: float = 0.0


def next_step(command: Command, now_s: float, boot: str | None, sent: Sent, ack_timeout_s: float) -> Step:
    """Return the next step of a command; `boot` is the connected run of the program, None while away."""
    if command.is_open and now_s >= command.deadline_s:
        return Step.EXPIRE
    if boot is None or not command.is_open:
        return Step.WAIT
    if command.boot is None:
        # A motion is recorded as sent when it is created, so one that was not sent is too late.
        return Step.GIVE_UP if command.kind is CommandKind.MOTION else Step.SEND
    if command.boot != boot:
        return Step.SEND if command.kind is CommandKind.SETTING else Step.GIVE_UP
    is_due = command.kind is not CommandKind.MOTION and (
        sent.times == 0
        or (command.state is CommandState.SENT and now_s >= sent.at_s + _resend_s(sent, ack_timeout_s))
    )
    return Step.SEND if is_due else Step.WAIT


def _resend_s(sent: Sent, ack_timeout_s: float) -> float:
    return ack_timeout_s * min(2.0 ** min(sent.times - 1, 10), MAX_RESEND_FACTOR)


def answered(command: Command, answer: CommandAnswer, *, is_cancelling: bool = False) -> Command:
    """Return the command after an answer of the device; the first final answer counts."""
    if not command.is_open:
        return command
    if answer.state is None:
        state = CommandState.CANCELLED if is_cancelling else CommandState.FAILED
        return replace(command, state=state, reason=answer.reason)
    if answer.state is AnswerState.DONE:
        return replace(command, state=CommandState.DONE, progress=1.0, result=dict(answer.result or {}))
    progress = command.progress if answer.progress is None else answer.progress
    if answer.state is AnswerState.RUNNING:
        return replace(command, state=CommandState.RUNNING, progress=progress)
    # A repeated "accepted" says nothing new once it runs.
    state = command.state if command.state is CommandState.RUNNING else CommandState.ACCEPTED
    return replace(command, state=state, progress=progress)
