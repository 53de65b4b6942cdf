"""The case of the operator of the bin-picking cell: strain slows the UR10, a lasting one proposes a break.

The robot and its limits are those of the trajectory tool, which gets the limit from human state directly.
This machine moves nothing: it performs what the operator does, and reads what robot and process do.
"""

import asyncio
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import orjson

from handover.errors import HandoverError
from handover.messages import message
from handover.network.http_client import BodyReadingHttpClient, SendError
from handover.security.service_access import ServiceAccess
from handover.service_addresses import ASSISTIVE_DEVICES
from handover_cases.machine import Case, Machine, MachineContext, MachineState, Seen
from handover_cases.model.body import FREE_BPM, STRAINED_BPM
from handover_cases.model.sensor import Sensor
from handover_cases.trial import HEART_RATE_IS_VALID, NOT_IN_PAPER, Trial, TrialFailed

BPMN: Final = Path(__file__).parent / "operator_shift.bpmn"
DEFINITION: Final = "operator-shift"
ROBOT: Final = "ur10-1"
POLL_S: Final = 0.5
TIMEOUT_S: Final = 5.0
STRAIN: Final = 0.85
FULL_PACE: Final = 0.95
PATIENCE_S: Final = 900.0
REST_BPM: Final = 65.0
MAXIMUM_BPM: Final = 185.0
LEAST: Final = 0.2


class OperatorMachine(Machine):
    """The simulated operator, with what the robot and the process do."""

    def __init__(self) -> None:
        self.effort = 0.0
        self.heart_rate_bpm: float | None = None
        self.pace: float | None = None
        """The fraction of its speed at which the robot may move now, as the trajectory tool says."""
        self.rule = ""
        self.needs_reset = False
        self.moves = 0
        self.breaks = 0
        self._process: str | None = None
        self._fraction = 0.0
        self._reason = ""

    def prepare(self, context: MachineContext) -> None:
        self.settings = context.settings
        self._access = ServiceAccess(self.settings, ASSISTIVE_DEVICES)
        self._http = BodyReadingHttpClient(ca_files=self.settings.ca_files, max_response_bytes=1024 * 1024)

    def start(self) -> None:
        """The process moves the robot; nothing starts here."""

    def stop(self) -> None:
        self.effort = 0.0

    def step(self, seen: Seen) -> None:
        self.heart_rate_bpm = seen.body.number("heartRate", seen.now_s, 3.0)
        self._fraction, self._reason = seen.allowed.fraction, str(seen.allowed.reason)

    def acts(self) -> Mapping[str, Any]:
        return {"effort": self.effort, "posture": "standing"}

    def state(self) -> MachineState:
        pace = self.pace
        state = "break" if self.breaks else "working" if self._process else "idle"
        values = {"moves": (float(self.moves), ""), "breaks": (float(self.breaks), "")}
        chart = {"fraction": self._fraction}
        if pace is not None:
            values["robotFraction"] = (pace, "P1")
            chart["robotFraction"] = pace
        if self.heart_rate_bpm is not None:
            chart["heartRate"] = self.heart_rate_bpm
        return MachineState(state, self.rule or self._reason, values, chart, self._process is not None)

    async def work(self) -> None:
        while True:
            try:
                await self._look()
            except (SendError, OSError, HandoverError, ValueError, KeyError):
                self.pace = None  # unknown, while a service restarts
            await asyncio.sleep(POLL_S)

    async def _look(self) -> None:
        limits = await self._ask("GET", f"{self.settings.trajectory_tool}/robots/{ROBOT}/limits")
        self.pace, self.rule = float(limits["pace"]), str(limits["reason"] or "")
        self.needs_reset = bool(limits["needsReset"])
        if self._process is not None:
            process = await self._ask("GET", f"{self.settings.orchestrator}/processes/{self._process}")
            elements = process["elements"]
            self.moves = sum(int(elements.get(name, {}).get("completed", 0)) for name in ("home", "reach"))
            self.breaks = int(elements.get("take_break", {}).get("running", 0))

    async def perform_trial(self, trial: Trial) -> None:
        await trial.until(HEART_RATE_IS_VALID, lambda: self.heart_rate_bpm is not None, PATIENCE_S)
        await trial.permission(PATIENCE_S)
        await self._begin_shift()
        try:
            await self._work_calmly(trial)
            await self._work_hard(trial)
            await self._recover(trial)
        finally:
            await self._end_shift()

    async def _work_calmly(self, trial: Trial) -> None:
        trial.say(message("case.picking.begins", "the shift begins: the robot moves beside the operator"))
        await self._until_faster(trial, FULL_PACE)
        self._say_pace(trial)

    def _say_pace(self, trial: Trial) -> None:
        trial.say(
            message(
                "case.picking.pace",
                "{bpm} bpm: the robot moves at {percent} %",
                bpm=round(self.heart_rate_bpm or 0),
                percent=round(100 * (self.pace or 0)),
            )
        )

    async def _until_faster(self, trial: Trial, pace: float) -> None:
        """Wait until the robot may move at `pace`; the person in charge releases stops meanwhile.

        A stop is from before the first heart rate, or from a machine that stood still for seconds.
        """
        began_s = time.monotonic()
        while (self.pace or 0) < pace:
            await trial.permission(PATIENCE_S)
            if self.needs_reset:
                await self._release()
            if time.monotonic() - began_s > PATIENCE_S:
                raise TrialFailed(
                    message(
                        "case.picking.slow",
                        "{percent} % of the speed: not within {seconds} s",
                        percent=round(100 * pace),
                        seconds=round(PATIENCE_S),
                    )
                )
            await asyncio.sleep(POLL_S)

    async def _release(self) -> None:
        """Release a stop of the robot, as the person in charge; one that cannot be released yet stays."""
        by = orjson.dumps({"name": "person in charge"})
        with suppress(TrialFailed):
            await self._ask("POST", f"{self.settings.trajectory_tool}/robots/{ROBOT}/limits/reset", by)

    async def _work_hard(self, trial: Trial) -> None:
        self.effort, began_s, calm = STRAIN, time.monotonic(), self.pace or 1.0
        trial.say(message("case.picking.lifts", "the operator lifts boxes"))
        slower = message("case.picking.wait.slower", "a slower robot")
        slowed_s = await trial.until(slower, lambda: (self.pace or 1) <= 0.5, PATIENCE_S)
        pace, bpm = self.pace or 0.0, self.heart_rate_bpm or 0.0
        self._say_pace(trial)
        proposed = message("case.picking.wait.break", "a proposed break")
        await trial.until(proposed, lambda: self.breaks >= 1, PATIENCE_S)
        asked_s = round(time.monotonic() - began_s)
        trial.say(
            message(
                "case.picking.break", "a break is proposed to the process after {seconds} s", seconds=asked_s
            )
        )
        trial.compare(
            message("case.picking.figure.slows", "strain slows the UR10"),
            message("case.picking.paper.slows", "proposed (section 5.1, applicability)"),
            message(
                "case.picking.ours.slows",
                "{before} % to {after} % in {seconds} s at {bpm} bpm",
                before=round(100 * calm),
                after=round(100 * pace),
                seconds=round(slowed_s),
                bpm=round(bpm),
            ),
            pace < calm,
        )
        trial.compare(
            message("case.picking.figure.break", "a lasting strain proposes a break to the process"),
            NOT_IN_PAPER,
            message(
                "case.picking.ours.break",
                "after {seconds} s; Tasks to take a break: {count}",
                seconds=asked_s,
                count=self.breaks,
            ),
            self.breaks == 1,
        )
        slowest = self.pace or 0.0
        trial.compare(
            message("case.picking.figure.no_stop", "the robot does not stop for strain alone"),
            NOT_IN_PAPER,
            message("case.picking.ours.no_stop", "{percent} % at least", percent=round(100 * slowest)),
            None if self.needs_reset else slowest >= LEAST - 0.01,
        )

    async def _recover(self, trial: Trial) -> None:
        slow = self.pace or 0.0
        self.effort = 0.0
        await self._until_faster(trial, slow + 0.1)
        trial.say(message("case.picking.rests", "the operator rests"))
        self._say_pace(trial)
        moves = message("case.picking.figure.moves", "moves of the robot")
        trial.compare(moves, "", str(self.moves), self.moves >= 2)

    async def _begin_shift(self) -> None:
        """Deploy the process, and start it with the pseudonym of the operator as its key."""
        orchestrator = self.settings.orchestrator
        person = await self._ask("GET", f"{self.settings.human_state}/people/{CASE.person}")
        await self._ask("POST", f"{orchestrator}/definitions", BPMN.read_bytes(), "application/xml")
        order = orjson.dumps({"definition": DEFINITION, "key": person["pseudonym"]})
        process = await self._ask("POST", f"{orchestrator}/processes", order)
        self._process, self.moves, self.breaks = str(process["id"]), 0, 0

    async def _end_shift(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            by = orjson.dumps({"by": "the case"})
            await self._ask("POST", f"{self.settings.orchestrator}/processes/{process}/cancel", by)

    async def _ask(
        self, method: str, url: str, body: bytes = b"", media_type: str = "application/json"
    ) -> dict[str, Any]:
        headers = [("Content-Type", media_type)]
        answer = await self._access.send(self._http, method, url, headers, body, timeout_s=TIMEOUT_S)
        if answer.status >= 300:
            raise TrialFailed(f"{method} {url} answered {answer.status}: {answer.body[:200].decode()}")
        document: dict[str, Any] = orjson.loads(answer.body)
        return document


CASE: Final = Case(
    name="bin-picking",
    summary="The operator of a robot: strain slows the UR10, a lasting one proposes a break.",
    robot=ROBOT,
    category="robot",
    make=OperatorMachine,
    sensors=(
        Sensor(
            "case-bin-picking",
            {
                "signals": ["heartRate"],
                "packet_s": 0.25,
                "rest_bpm": REST_BPM,
                "max_bpm": MAXIMUM_BPM,
            },
        ),
    ),
    person_settings={
        "restBpm": REST_BPM,
        "maximumBpm": MAXIMUM_BPM,
        "freeBpm": FREE_BPM,
        "strainedBpm": STRAINED_BPM,
        "leastFraction": LEAST,
    },
    services=("task-orchestrator", "trajectory-tool"),
    is_own_machine=False,
)
