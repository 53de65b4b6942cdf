"""The progress of a process on the terminal: one line for each event of its Tasks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from handover.tasks.task_life import performers_of
from handover_datamodels.entities import Outcome, Task, TaskStatus

Say = Callable[[str], None]

OUTCOMES = {Outcome.NOT_GOOD.value: '"not good"', Outcome.PROBLEM.value: '"problem"'}
"""The texts of outcomes other than `ok`."""

_BEFORE_PAUSE = frozenset({TaskStatus.PENDING, TaskStatus.ASSIGNED, TaskStatus.IN_PROGRESS})


@dataclass
class ProgressPrinter:
    """Prints the progress of one process; `update` gets all its Tasks and prints only what is new."""

    began: datetime
    say: Say
    _printed: dict[str, set[str]] = field(default_factory=dict)
    _asked_at: dict[str, datetime] = field(default_factory=dict)
    done: list[Task] = field(default_factory=list)

    def update(self, tasks: Sequence[Task]) -> None:
        """Print the changes of `tasks` since the last call."""
        for task in sorted(tasks, key=self._when):
            printed = self._printed.setdefault(task.id, set())
            status = task.status.value
            if not printed:
                self._asked_at[task.id] = self._when(task)
                self._line(task, self._asked(task))
                printed.add(TaskStatus.PENDING)
            if status in printed or status in {
                TaskStatus.PENDING,
                TaskStatus.ASSIGNED,
                TaskStatus.IN_PROGRESS,
            }:
                if status is TaskStatus.IN_PROGRESS and TaskStatus.PAUSED in printed:
                    printed.discard(TaskStatus.PAUSED)
                    self._line(task, "continues")
                continue
            printed.add(status)
            if status is TaskStatus.PAUSED:
                self._line(task, "pauses")
            else:
                self.done.append(task)
                self._line(task, self._ended(task))

    def summary(self) -> str:
        """Return a summary: the number of Tasks and the time by operator and robot."""
        people = [task for task in self.done if outputs_of(task).get("by") in {"gesture", "screen"}]
        robots = [task for task in self.done if task not in people]
        gestures = {str(outputs_of(task)["gesture"]) for task in people if "gesture" in outputs_of(task)}
        return (
            f"{len(self.done)} Tasks: {len(people)} by the operator with {len(gestures)} different gestures "
            f"in {self._took_s(people):.1f} s, {len(robots)} by the robot in {self._took_s(robots):.1f} s"
        )

    def _took_s(self, tasks: Sequence[Task]) -> float:
        return sum((self._when(task) - self._asked_at[task.id]).total_seconds() for task in tasks)

    def _asked(self, task: Task) -> str:
        parameters = parameters_of(task)
        if "gesture" in parameters or "commandId" in parameters:
            gesture = parameters.get("gesture", "the gesture")
            return f'is asked: "{parameters.get("description", "")}"; show {gesture}'
        return f"takes over: {parameters.get('operation', 'work')}"

    def _ended(self, task: Task) -> str:
        seconds = (self._when(task) - self._asked_at[task.id]).total_seconds()
        outputs = outputs_of(task)
        outcome = OUTCOMES.get(str(outputs.get("outcome", "")))
        if outcome is not None:
            note = f": {outputs['note']}" if outputs.get("note") else ""
            return f"answered {outcome} {_by(outputs)}after {seconds:.1f} s{note}"
        if task.status.value is TaskStatus.FAILED:
            return f"failed after {seconds:.1f} s: {outputs.get('reason', 'no reason given')}"
        if outputs.get("by") == "screen":
            return f"confirmed on the screen after {seconds:.1f} s"
        if "gesture" in outputs:
            held_s = outputs["heldMs"] / 1000
            return f"showed {outputs['gesture']} for {held_s:.1f} s, {seconds:.1f} s after being asked"
        operation = parameters_of(task).get("operation", "work")
        part = {True: ", part found", False: ", no part found"}.get(outputs.get("found", ""), "")
        return f"{operation} done in {seconds:.1f} s{part}"

    def _line(self, task: Task, words: str) -> None:
        at_s = (self._when(task) - self.began).total_seconds()
        self.say(f"{max(at_s, 0):6.1f} s  {self._who(task):<9} {words}")

    def _who(self, task: Task) -> str:
        involved = performers_of(link.object for link in task.involves or ())
        return involved[0].rsplit(":", 1)[-1] if involved else "nobody"

    def _when(self, task: Task) -> datetime:
        return task.status.observed_at or self.began


def _by(outputs: Mapping[str, Any]) -> str:
    if outputs.get("by") == "screen":
        return "on the screen "
    return f"with {outputs['gesture']} " if "gesture" in outputs else ""


def parameters_of(task: Task) -> dict[str, Any]:
    """Return the workParameters, empty if there are none."""
    return dict(task.work_parameters.value) if task.work_parameters else {}


def outputs_of(task: Task) -> dict[str, Any]:
    """Return the outputParameters, empty if there are none."""
    return dict(task.output_parameters.value) if task.output_parameters else {}
