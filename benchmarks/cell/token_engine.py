"""The token engine of the orchestrator alone, without database and broker, beside SpiffWorkflow.

    python -m benchmarks.cell.token_engine [--instances 2000] [--rounds 100000]

Prints the CPU time of a step of a sequence of five activities and of the first to the last round of two
loops, the size of the snapshot of an instance that waits, and the time to restore one. A step completes an
activity and takes a snapshot. SpiffWorkflow (a development dependency) runs the same files for
`SPIFF_ROUNDS` rounds; it stalls after round 333.
"""

import argparse
import io
import time
from collections.abc import Callable
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any, Protocol

from benchmarks.steal_time import report_steal_time
from handover_bpmn.definitions import Definitions
from handover_bpmn.execution.run import Run
from handover_bpmn.notation.file import read_bpmn

try:
    from SpiffWorkflow.bpmn.parser.BpmnParser import BpmnParser
    from SpiffWorkflow.bpmn.serializer.workflow import BpmnWorkflowSerializer
    from SpiffWorkflow.bpmn.workflow import BpmnWorkflow
    from SpiffWorkflow.util.task import TaskState
except ImportError:
    BpmnParser = None

NOW = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)
SPIFF_INSTANCES = 20
SPIFF_ROUNDS = 150
SPIFF_ROUNDS_MEASURED = 5
ROUNDS_MEASURED = 200


def file(content: str) -> bytes:
    """Return the BPMN file of a process."""
    return (
        '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="urn:benchmark">'
        f'<process id="p" isExecutable="true">{content}</process></definitions>'
    ).encode()


def flow(source: str, target: str, condition: str = "") -> str:
    """Return a sequence flow."""
    inner = condition and f"<conditionExpression>{condition}</conditionExpression>"
    name = f"{source}_{target}"
    return f'<sequenceFlow id="{name}" sourceRef="{source}" targetRef="{target}">{inner}</sequenceFlow>'


def path(*names: str) -> str:
    """Return the sequence flows from each element to the next."""
    return "".join(flow(source, target) for source, target in pairwise(names))


ENDS = '<startEvent id="start"/><endEvent id="end"/>'
LOOP = '<exclusiveGateway id="in"/><exclusiveGateway id="out" default="out_in"/>'
SEQUENCE = file(
    ENDS
    + "".join(f'<userTask id="t{number}"/>' for number in range(5))
    + path("start", "t0", "t1", "t2", "t3", "t4", "end")
)
ONE_TASK_LOOP = file(
    f'{ENDS}{LOOP}<userTask id="a"/>' + path("start", "in", "a", "out", "in") + flow("out", "end", "stop")
)
PARALLEL_LOOP = file(
    f'{ENDS}{LOOP}<parallelGateway id="split"/><parallelGateway id="join"/>'
    + '<userTask id="a"/><userTask id="b"/>'
    + path("start", "in", "split", "a", "join", "out", "in")
    + path("split", "b", "join")
    + flow("out", "end", "stop")
)


class Instance(Protocol):
    """An instance of a process in an engine."""

    def step(self) -> None:
        """Complete the first open activity and take a snapshot."""

    def done(self) -> bool:
        """Return whether the process has ended."""

    def size(self) -> int:
        """Return the bytes of the snapshot."""

    def restore(self) -> None:
        """Continue with the state of the snapshot."""


class _Ours:
    def __init__(self, library: Definitions) -> None:
        self.library = library
        self.run = Run.start(library.plans["p"], {"stop": False}, NOW, library)

    def step(self) -> None:
        self.run.complete(self.run.open()[0].token, {"part": 7}, NOW)

    def done(self) -> bool:
        return self.run.completed

    def size(self) -> int:
        return len(self.run.snapshot())

    def restore(self) -> None:
        self.run = Run.resume(self.library.plans["p"], self.run.snapshot(), self.library)


class _Spiff:
    def __init__(self, spec: Any) -> None:
        self.serializer = BpmnWorkflowSerializer()
        self.workflow = BpmnWorkflow(spec)
        self.workflow.task_tree.data = {"stop": False}
        self.workflow.do_engine_steps()
        self.snapshot = self.serializer.serialize_json(self.workflow)

    def step(self) -> None:
        task = next(
            candidate
            for candidate in self.workflow.get_tasks(state=TaskState.READY)
            if candidate.task_spec.manual
        )
        task.data["part"] = 7
        task.run()
        self.workflow.do_engine_steps()
        self.snapshot = self.serializer.serialize_json(self.workflow)

    def done(self) -> bool:
        return bool(self.workflow.is_completed())

    def size(self) -> int:
        return len(self.snapshot)

    def restore(self) -> None:
        self.workflow = self.serializer.deserialize_json(self.snapshot)


def cpu_us(act: Callable[[], object], times: int = 1) -> float:
    """Return the microseconds of CPU time of one `act`, the mean of `times`."""
    started = time.process_time()
    for _ in range(times):
        act()
    return (time.process_time() - started) * 1e6 / times


def measure_sequence(start: Callable[[], Instance], instances: int) -> tuple[float, float]:
    """Return the CPU time of a start and of a step."""
    runs: list[Instance] = []
    starting = cpu_us(lambda: runs.append(start()), instances)

    def finish() -> None:
        run = runs.pop()
        while not run.done():
            run.step()

    return starting, cpu_us(finish, instances) / 5


def measure_loop(run: Instance, steps_a_round: int, rounds: list[int], measured: int) -> dict[int, float]:
    """Return the CPU time of a step in some rounds, the mean of `measured` rounds from each on."""
    medians: dict[int, float] = {}
    number = 1
    while number <= rounds[-1]:
        if number in rounds:
            medians[number] = cpu_us(run.step, steps_a_round * measured)
            number += measured
            continue
        for _ in range(steps_a_round):
            run.step()
        number += 1
    return medians


def report(name: str, figures: dict[str, Any]) -> None:
    """Print a line of figures."""
    print(f"{name:14}" + "".join(f"{label} {value}   " for label, value in figures.items()))


def measure(
    name: str,
    start: Callable[[bytes], Callable[[], Instance]],
    instances: int,
    rounds: list[int],
    rounds_measured: int,
) -> None:
    """Print the figures of one engine; `start` prepares a file and returns how an instance of it starts."""
    starting, step = measure_sequence(start(SEQUENCE), instances)
    waiting = start(SEQUENCE)()
    restoring = cpu_us(waiting.restore, instances)
    report(name, {"start": f"{starting:.0f} µs", "step": f"{step:.0f} µs", "restore": f"{restoring:.0f} µs"})
    report(name, {"snapshot of a waiting instance": f"{waiting.size()} B"})
    for label, xml, steps in (("loop", ONE_TASK_LOOP, 1), ("parallel loop", PARALLEL_LOOP, 2)):
        run = start(xml)()
        measured = measure_loop(run, steps, rounds, rounds_measured)
        report(name, {f"{label}, step of round {number}:": f"{us:.0f} µs" for number, us in measured.items()})
        report(name, {f"{label}, snapshot at the end:": f"{run.size()} B"})


def _start_ours(xml: bytes) -> Callable[[], Instance]:
    library = Definitions(read_bpmn(xml).definitions)
    return lambda: _Ours(library)


def _start_spiff(xml: bytes) -> Callable[[], Instance]:
    parser = BpmnParser()
    parser.add_bpmn_io(io.BytesIO(xml))
    spec = parser.get_spec("p")
    return lambda: _Spiff(spec)


def main() -> None:
    """Measure both engines and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--instances", type=int, default=2000)
    parser.add_argument("--rounds", type=int, default=100_000)
    arguments = parser.parse_args()
    with report_steal_time():
        rounds = [1, 1000, arguments.rounds]
        measure("ours", _start_ours, arguments.instances, rounds, ROUNDS_MEASURED)
        if BpmnParser is not None:
            rounds = [1, SPIFF_ROUNDS // 2, SPIFF_ROUNDS]
            measure("SpiffWorkflow", _start_spiff, SPIFF_INSTANCES, rounds, SPIFF_ROUNDS_MEASURED)


if __name__ == "__main__":
    main()
