"""Documents of messages, signals and pauses."""

from typing_extensions import TypedDict

from handover_processes.records.messages import MessageOutcome


class SentMessage(TypedDict):
    """The outcome of a message, and the process that it reached or started."""

    outcome: MessageOutcome
    process: str | None


class SentSignal(TypedDict):
    """The processes that a signal reached or started."""

    processes: list[str]


class PausedProcesses(TypedDict):
    """The processes that were paused or resumed."""

    processes: list[str]
