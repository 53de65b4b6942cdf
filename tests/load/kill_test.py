"""Processes of all element kinds, while broker, orchestrator and performer are killed at random moments.

    python -m tests.load.kill_test [--seconds 600] [--processes 1000] [--seed 7]

Kills a random member with SIGKILL every few seconds and starts it again. At the end every process must have
completed; every Task must have been done once and have ended once. A motion whose performer was killed during
it must not be repeated: its process stands with an incident, which is counted. Exits with 1 and lists the
faults otherwise.
"""

import argparse
import random
import re
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import orjson

from handover.tasks.outcomes import OUTCOME_UNKNOWN
from services.task_orchestrator.tests.integration.cell import Cell, cell
from services.task_orchestrator.tests.integration.test_elements import CASES as ELEMENTS
from services.task_orchestrator.tests.integration.test_elements import Case
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, path, start
from tests.kit.ports import next_free_port

PAUSE_S = (1.0, 5.0)
"""Between two kills."""
DOWN_S = (0.0, 2.0)
STARTED_WITHIN = 0.8
"""The share of the time in which processes are started."""
SETTLE_S = 900.0
POLL_S = 1.0
SEND_AGAIN_S = 20.0
MOTION = "motion"
"""The case of a motion, whose outcome is unknown if its performer is killed during it."""
MOTION_EVERY = 5
"""One of so many processes is a motion."""
MOTION_S = 1.0
KILLED_IN_MOTION = 0.25
"""The share of the kills that wait for a motion and kill its performer."""
CASES = {
    **ELEMENTS,
    MOTION: Case(
        start() + activity("grip_part") + end() + path("start", "grip_part", "end"),
        ["grip_part-1"],
        script={"grip_part-1": {"moves_s": MOTION_S}},
    ),
}
ENDS = frozenset({"completed", "failed"})
_SHORT_TIMER = re.compile(r"timerEventDefinition><bpmn:\w+[^>]*>(?!PT1H)")


@dataclass
class Report:
    """What the run found."""

    kills: Counter[str] = field(default_factory=Counter)
    completed: int = 0
    incidents: list[str] = field(default_factory=list)
    tasks: int = 0
    faults: list[str] = field(default_factory=list)


@dataclass
class Run:
    """A cell in which every case is deployed, and the processes that were started."""

    cell: Cell
    chance: random.Random
    report: Report = field(default_factory=Report)
    started: dict[str, str] = field(default_factory=dict)
    """The case of each process."""
    sent: dict[str, list[float]] = field(default_factory=dict)
    """When a message or signal was sent to each process."""

    def deploy(self) -> None:
        """Deploy every case."""
        answers: dict[str, Any] = {}
        for case in CASES.values():
            answers |= case.script
        self.cell.script_file.write_bytes(orjson.dumps(answers))
        for name, case in CASES.items():
            xml = drawing(case.body, beside=case.beside.format(name=name), name=name)
            headers = {"Content-Type": "application/xml"}
            self.cell.api.post("/definitions", content=xml, headers=headers).raise_for_status()

    def ask(self, method: str, path: str, **request: Any) -> Any:
        """Send a request that may be repeated, until the orchestrator answers it."""
        while True:
            try:
                answer = self.cell.api.request(method, path, **request)
            except httpx.TransportError:
                time.sleep(0.2)
                continue
            if answer.status_code < 500:
                answer.raise_for_status()
                return answer.json()
            time.sleep(0.2)

    def start(self, number: int) -> None:
        """Start a process of the next case; its key makes a repeated request harmless."""
        others, rest = divmod(number * (MOTION_EVERY - 1), MOTION_EVERY)
        name = MOTION if rest == 0 else list(ELEMENTS)[others % len(ELEMENTS)]
        body = {"definition": name, "parameters": CASES[name].variables, "key": f"kill test {number}"}
        self.started[self.ask("POST", "/processes", json=body)["id"]] = name

    @contextmanager
    def killing(self) -> Iterator[None]:
        """Kill members at random moments; every member runs again afterwards."""
        stopped = threading.Event()

        def kill_forever() -> None:
            while not stopped.wait(self.chance.uniform(*PAUSE_S)):
                member = self.chance.choice(self.cell.members)
                if self.chance.random() < KILLED_IN_MOTION and self._wait_for_motion(stopped):
                    member = self.cell.performer
                member.kill()
                self.report.kills[member.name] += 1
                time.sleep(self.chance.uniform(*DOWN_S))
                member.start()

        with ThreadPoolExecutor(1) as executor:
            killer = executor.submit(kill_forever)
            try:
                yield
            finally:
                stopped.set()
                killer.result()

    def _wait_for_motion(self, stopped: threading.Event) -> bool:
        """Wait until a motion begins, and for a random part of it; return False if none begins in time."""
        known = set(_lines(self.begun_file))
        ends = time.monotonic() + PAUSE_S[1]
        while not known.symmetric_difference(_lines(self.begun_file)):
            if stopped.wait(0.02) or time.monotonic() > ends:
                return False
        time.sleep(self.chance.uniform(0.0, MOTION_S))
        return True

    def send_messages(self) -> list[dict[str, Any]]:
        """Send to each process what it waits for; return the processes that have not ended."""
        running = self.ask("GET", "/processes", params={"status": "inProgress", "limit": 1000})
        mine = [each for each in running if each["id"] in self.started]
        for each in mine:
            send = CASES[self.started[each["id"]]].send
            last_s = self.sent.get(each["id"], [-SEND_AGAIN_S])[-1]
            if send is None or not each["waiting"] or time.monotonic() - last_s < SEND_AGAIN_S:
                continue
            path, body = send
            if path == "/messages":
                body = {**body, "process": each["id"], "ttl": "PT0S"}
            self._send(each["id"], path, body)
        return mine

    def _send(self, process: str, path: str, body: dict[str, Any]) -> None:
        """Send a message or signal once; it may have been delivered even if no answer came."""
        name = self.started[process]
        reached = (
            [process]
            if path == "/messages"
            else [each for each, case in self.started.items() if case == name]
        )
        for each in reached:
            self.sent.setdefault(each, []).append(time.monotonic())
        with suppress(httpx.HTTPError):
            self.cell.api.post(path, json=body).raise_for_status()

    def settle(self) -> None:
        """Wait until every process has ended or stands with an incident."""
        ends = time.monotonic() + SETTLE_S
        while any(not each["incidents"] for each in self.send_messages()):
            if time.monotonic() > ends:
                return
            time.sleep(POLL_S)

    def check(self) -> None:
        """Compare what was done with what each process asks for."""
        done = Counter(self.cell.done())
        known: set[str] = set()
        for process, name in self.started.items():
            seen = self.ask("GET", f"/processes/{process}")
            known.update(task["id"] for task in seen["tasks"])
            self._check_process(seen, name, CASES[name], done)
        begun = Counter(_lines(self.begun_file))
        self.report.faults += [f"{task} was begun {n} times" for task, n in begun.items() if n > 1]
        for task, times in done.items():
            if times > 1:
                self.report.faults.append(f"{task} was done {times} times")
            if task not in known and ":Task:demo:" in task and _process_of(task) in self.started:
                self.report.faults.append(f"{task} was done, but is no Task of its process")

    @property
    def begun_file(self) -> Path:
        """Return the file of the motions that were begun."""
        return self.cell.done_file.with_suffix(".begun")

    def _check_process(self, seen: dict[str, Any], name: str, case: Case, done: Counter[str]) -> None:
        process, faults = seen["id"], self.report.faults
        self.report.tasks += len(seen["tasks"])
        if seen["incidents"]:
            found = f"{process} ({name}): {seen['incidents'][0]['reason']}"
            if name == MOTION and seen["incidents"][0]["reason"].startswith(OUTCOME_UNKNOWN):
                self.report.incidents.append(found)
            else:
                faults.append(found)
            return
        if seen["status"] not in ENDS:
            faults.append(f"{process} has neither ended nor an incident; it waits at {seen['waiting']}")
            return
        self.report.completed += 1
        if seen["status"] != case.status:
            faults.append(f"{process} is {seen['status']}: {seen['reason']}")
        for task in seen["tasks"]:
            ends = sum(change["status"] in ENDS for change in task["history"])
            if ends != 1:
                faults.append(f"{task['id']} has ended {ends} times")
        prefix = f"urn:ngsi-ld:Task:demo:{process}-"
        acts = sorted(task.removeprefix(prefix) for task in done if task.startswith(prefix))
        if len(self.sent.get(process, [])) > 1:  # what does not interrupt happens as often as it was sent
            return
        if acts != case.done and not _SHORT_TIMER.search(case.body):
            faults.append(f"{process} ({name}): {acts} was done instead of {case.done}")


def _lines(file: Path) -> list[str]:
    return file.read_text().split() if file.exists() else []


def _process_of(task: str) -> str:
    return task.rpartition(":")[2].rsplit("-", 2)[0]


def run(seconds: float, count: int, seed: int, note: Callable[[str], None] = print) -> Report:
    """Run `count` processes while members are killed for `seconds`; return what was found."""
    with (
        tempfile.TemporaryDirectory(prefix="handover-kill-test-", ignore_cleanup_errors=True) as folder,
        cell(Path(folder), next_free_port) as running,
    ):
        test = Run(running, random.Random(seed))
        test.deploy()
        began = time.monotonic()
        with test.killing():
            for number in range(count):
                test.start(number)
                due = began + seconds * STARTED_WITHIN * (number + 1) / count
                if time.monotonic() < due:
                    test.send_messages()
                    time.sleep(max(0.0, due - time.monotonic()))
            while time.monotonic() < began + seconds:
                test.send_messages()
                time.sleep(POLL_S)
        note(f"kills: {dict(test.report.kills)}; {len(test.started)} processes started")
        test.settle()
        test.check()
        return test.report


def main() -> int:
    """Run the kill test; return 1 if something was lost or doubled."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seconds", type=float, default=600.0, help="how long members are killed")
    parser.add_argument("--processes", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=None, help="of the moments; random by default")
    arguments = parser.parse_args()
    seed = random.randrange(1_000_000) if arguments.seed is None else arguments.seed
    print(f"seed {seed}", flush=True)
    report = run(arguments.seconds, arguments.processes, seed)
    print(
        f"{report.completed} processes ended, {len(report.incidents)} stand with an incident; "
        f"{report.tasks} Tasks; {len(report.faults)} faults"
    )
    for line in (*report.incidents, *report.faults):
        print(f"  {line}")
    return 1 if report.faults else 0


if __name__ == "__main__":
    sys.exit(main())
