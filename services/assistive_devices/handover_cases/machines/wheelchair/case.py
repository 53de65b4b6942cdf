"""The case of the wheelchair: ROS4HC, section 5.1."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from handover.messages import message
from handover_cases.machine import Case, Machine, MachineState, Seen
from handover_cases.machines.wheelchair.controller import Centre, Wheelchair, WheelchairParameters
from handover_cases.machines.wheelchair.simulation import Chair, Driver
from handover_cases.model.body import FREE_BPM, STRAINED_BPM
from handover_cases.model.command import Command, VelocityCommand
from handover_cases.model.sensor import Sensor
from handover_cases.trial import (
    BODY_IS_CALM,
    HEART_RATE_IS_VALID,
    LIMIT_FALLS,
    NOT_IN_PAPER,
    TIME_IS_OVER,
    Trial,
)

PAPER_DURATION_S: Final = 180.0
SHORT_S: Final = 60.0
"""A trial that is to be shorter leaves out the stop at 125 bpm and the strap."""
CENTRE_MAX_AGE_S: Final = 0.5
STRAIN: Final = 0.75
MIN_MOVING_MPS: Final = 0.02
PATIENCE_S: Final = 240.0
CHAIR_DRIVES: Final = message("case.wheelchair.wait.drives", "the chair drives")
CHAIR_STANDS: Final = message("case.wheelchair.wait.stands", "the chair stands")
DRIVES_AGAIN: Final = message("case.wheelchair.wait.again", "the chair drives again")


def vmax_of(heart_rate_bpm: float, max_speed_mps: float) -> float:
    """Return equation 2 of the paper: the greatest speed in m/s at a heart rate."""
    share = (heart_rate_bpm - FREE_BPM) / (STRAINED_BPM - FREE_BPM)
    return max_speed_mps * (1 - min(max(share, 0.0), 1.0))


class WheelchairMachine(Machine):
    """The controller, the simulated chair, and the person who drives it."""

    def __init__(self) -> None:
        self.controller = Wheelchair()
        self.chair = Chair()
        self.driver = Driver()
        self.heart_rate_bpm: float | None = None
        self.fraction = 0.0
        self._wants_to_drive = False
        self._has_contact = True
        self._centre: Centre | None = None
        self._allowed_reason = ""
        self._rise_mps = 0.0
        self._is_faulty = False

    def start(self) -> None:
        self.controller = self.controller.start()

    def stop(self) -> None:
        self.controller = self.controller.stop()
        self.driver = replace(self.driver, strain=0.0)
        self._wants_to_drive = False

    def step(self, seen: Seen) -> None:
        body, now_s = seen.body, seen.now_s
        x_mm = body.number("copX", now_s, CENTRE_MAX_AGE_S)
        y_mm = body.number("copY", now_s, CENTRE_MAX_AGE_S)
        self._centre = None if x_mm is None or y_mm is None else Centre(x_mm, y_mm)
        self.heart_rate_bpm = body.number("heartRate", now_s, 3.0)
        self.fraction, self._allowed_reason = seen.allowed.fraction, str(seen.allowed.reason)
        before = self.controller.vmax.value
        self.controller = self.controller.step(
            self._centre, self.fraction, seen.dt_s, may_rise=self.heart_rate_bpm is not None
        )
        if self._is_faulty and self.heart_rate_bpm is None:
            self._rise_mps = max(self._rise_mps, self.controller.vmax.value - before)
        self.chair = self.chair.step(self.controller.linear, self.controller.angular, seen.dt_s)
        self.driver = self.driver.step(self.chair, seen.dt_s, wants_to_drive=self._wants_to_drive)

    def acts(self) -> Mapping[str, Any]:
        return {
            "effort": round(self.driver.effort(self.chair), 3),
            "lean": [round(part, 3) for part in self.driver.lean],
            "posture": "sitting",
            "contact": self._has_contact,
        }

    def commands(self) -> Sequence[Command]:
        made = self.controller
        if not made.is_enabled and made.linear == made.angular == 0.0:
            return ()
        return (VelocityCommand("/cmd_vel", made.linear, made.angular),)

    def state(self) -> MachineState:
        controller, chair = self.controller, self.chair
        is_moving = abs(chair.linear_mps) > MIN_MOVING_MPS
        if not controller.is_enabled:
            state, reason = ("stopping", "a person stopped it") if is_moving else ("idle", "not started")
        elif self._centre is None:
            state, reason = "stopped", "no valid centre of pressure"
        elif not controller.is_calibrated:
            state, reason = "calibrating", "the person sits upright"
        elif self.fraction <= 0.0:
            state, reason = "stopped", self._allowed_reason
        else:
            state, reason = "driving", self._allowed_reason
        vmax, intent = controller.vmax.value, controller.intent[0]
        chart = {"speed": chair.linear_mps, "vmax": vmax, "intent": intent}
        if self.heart_rate_bpm is not None:
            chart["heartRate"] = self.heart_rate_bpm
        values = {
            "speed": (chair.linear_mps, "MTS"),
            "turn": (chair.angular_radps, "2A"),
            "vmax": (vmax, "MTS"),
            "intent": (intent, "MTS"),
            "commandLinear": (controller.linear, "MTS"),
            "commandAngular": (controller.angular, "2A"),
            "distance": (chair.travelled_m, "MTR"),
            "x": (chair.x_m, "MTR"),
            "y": (chair.y_m, "MTR"),
        }
        return MachineState(state, reason, values, chart, is_moving)

    async def perform_trial(self, trial: Trial) -> None:
        duration_s = trial.duration_s or PAPER_DURATION_S
        self.chair, self.driver = Chair(), Driver()
        self._rise_mps = 0.0
        await trial.until(HEART_RATE_IS_VALID, lambda: self.heart_rate_bpm is not None, PATIENCE_S)
        await trial.permission(PATIENCE_S)
        trial.say(
            message("case.wheelchair.sits", "heart rate {bpm} bpm; the person sits upright", bpm=self._bpm())
        )
        self.start()
        upright = message("case.wheelchair.wait.upright", "the upright posture")
        await trial.until(upright, lambda: self.controller.is_calibrated, PATIENCE_S)
        driven_s = time.monotonic()
        self._wants_to_drive = True
        await trial.calm(CHAIR_DRIVES, lambda: self.chair.linear_mps > 0.2, PATIENCE_S)
        trial.say(message("case.wheelchair.leans", "the person leans forwards and drives along the course"))
        await trial.calm(BODY_IS_CALM, lambda: self.fraction >= 0.99, PATIENCE_S)
        calm = WheelchairParameters().max_speed_mps * 0.75
        fast = message("case.wheelchair.wait.calm_speed", "the speed of a calm body")
        await trial.until(fast, lambda: self.chair.linear_mps >= calm, PATIENCE_S)
        fastest = self.chair.linear_mps
        trial.say(
            message(
                "case.wheelchair.works",
                "calm: {speed} m/s at {bpm} bpm; now the person works",
                speed=round(fastest, 2),
                bpm=self._bpm(),
            )
        )
        await self._strain(trial)
        if duration_s >= SHORT_S:
            await self._stop_at_125(trial)
            await self._lose_strap(trial)
            left_s = duration_s - (time.monotonic() - driven_s)
            if left_s > 0:
                trial.say(
                    message(
                        "case.wheelchair.drives_on",
                        "the person drives for another {seconds} s",
                        seconds=round(left_s),
                    )
                )
                await trial.until(
                    TIME_IS_OVER, lambda: time.monotonic() - driven_s >= duration_s, left_s + 60
                )
        self.stop()
        await trial.until(CHAIR_STANDS, lambda: not self.state().is_moving, PATIENCE_S)
        self._compare_course(trial, time.monotonic() - driven_s, fastest, calm)

    def _bpm(self) -> int:
        return round(self.heart_rate_bpm or 0)

    def _compare_course(self, trial: Trial, driven_s: float, fastest_mps: float, calm_mps: float) -> None:
        trial.compare(
            message("case.figure.trial", "trial"),
            message("case.wheelchair.paper.trial", "3 min in a room"),
            message(
                "case.wheelchair.ours.trial",
                "{seconds} s, {metres} m",
                seconds=round(driven_s),
                metres=round(self.chair.travelled_m),
            ),
        )
        trial.compare(
            message("case.wheelchair.figure.calm", "speed of a calm body"),
            message("case.wheelchair.paper.calm", "(figure 3c only)"),
            message("case.wheelchair.ours.speed", "{speed} m/s", speed=round(fastest_mps, 2)),
            fastest_mps >= calm_mps,
        )

    async def _strain(self, trial: Trial) -> None:
        """Let the heart rate rise, and compare vmax with equation 2."""
        self.driver = replace(self.driver, strain=STRAIN)
        maximum = self.controller.parameters.max_speed_mps
        worst = 0.0
        checked = {95.0: math.nan, 105.0: math.nan, 115.0: math.nan}

        def has_risen() -> bool:
            nonlocal worst
            rate = self.heart_rate_bpm
            if rate is not None and rate > FREE_BPM and self.fraction > 0:
                vmax = self.controller.vmax.value
                worst = max(worst, abs(vmax - vmax_of(rate, maximum)))
                checked.update(
                    {bpm: vmax for bpm, measured in checked.items() if math.isnan(measured) and rate >= bpm}
                )
            return rate is not None and rate >= 118

        rises = message("case.wheelchair.wait.rises", "the heart rate rises to 118 bpm")
        await trial.until(rises, has_risen, PATIENCE_S)
        slow, intent = self.chair.linear_mps, self.controller.intent[0]
        trial.say(
            message(
                "case.wheelchair.slowed",
                "{bpm} bpm: {speed} m/s, while the lean asks for {intent}",
                bpm=self._bpm(),
                speed=round(slow, 2),
                intent=round(intent, 2),
            )
        )
        paper = [round(vmax_of(bpm, maximum), 2) for bpm in checked]
        ours = [round(vmax, 2) for vmax in checked.values()]
        trial.compare(
            message("case.wheelchair.figure.vmax", "vmax at 95, 105 and 115 bpm"),
            message(
                "case.wheelchair.paper.vmax",
                "{first}; {second}; {third} m/s (equation 2)",
                first=paper[0],
                second=paper[1],
                third=paper[2],
            ),
            message(
                "case.wheelchair.ours.vmax",
                "{first}; {second}; {third} m/s (smoothed)",
                first=ours[0],
                second=ours[1],
                third=ours[2],
            ),
        )
        trial.compare(
            message(
                "case.wheelchair.figure.distance", "greatest distance to equation 2 while the rate rises"
            ),
            message("case.wheelchair.paper.distance", "0 (before its smoothing)"),
            message("case.wheelchair.ours.distance", "{speed} m/s (after ours)", speed=round(worst, 2)),
            worst <= 0.3,
        )
        trial.compare(
            message("case.wheelchair.figure.falls", "speed falls although the lean stays"),
            message("case.wheelchair.paper.falls", "yes (figure 3c)"),
            message(
                "case.wheelchair.ours.falls",
                "{speed} of {intent} m/s",
                speed=round(slow, 2),
                intent=round(intent, 2),
            ),
            slow <= 0.5 * maximum and intent >= 0.75 * maximum,
        )

    async def _stop_at_125(self, trial: Trial) -> None:
        stop = message("case.wheelchair.wait.stop", "a stop at 125 bpm")
        await trial.until(stop, lambda: self.fraction == 0.0, PATIENCE_S)
        await trial.until(CHAIR_STANDS, lambda: not self.state().is_moving, PATIENCE_S)
        trial.say(
            message(
                "case.wheelchair.stands",
                "{bpm} bpm: the chair stands, and waits for a reset",
                bpm=self._bpm(),
            )
        )
        vmax = self.controller.vmax.value
        trial.compare(
            message("case.wheelchair.figure.stop", "vmax from 125 bpm on"),
            "0",
            message("case.wheelchair.ours.speed", "{speed} m/s", speed=round(vmax, 2)),
            vmax <= MIN_MOVING_MPS,
        )
        self.driver = replace(self.driver, strain=0.0)
        rest = message("case.wheelchair.wait.rest", "the rest of the person")
        await trial.until(rest, lambda: (self.heart_rate_bpm or 200) < 105, PATIENCE_S)
        trial.say(message("case.wheelchair.rested", "rested; the person resets the stop"))
        await trial.reset()
        await trial.calm(DRIVES_AGAIN, lambda: self.fraction >= 0.4, PATIENCE_S)

    async def _lose_strap(self, trial: Trial) -> None:
        trial.say(message("case.strap_off", "the strap slips off"))
        self._is_faulty, self._has_contact = True, False
        fell_s = await trial.until(LIMIT_FALLS, lambda: self.fraction < 0.3, PATIENCE_S)
        stood_s = await trial.until(CHAIR_STANDS, lambda: not self.state().is_moving, PATIENCE_S)
        trial.compare(
            message("case.wheelchair.figure.strap", "strap off: slower than 30 %, then a stop"),
            NOT_IN_PAPER,
            message(
                "case.wheelchair.ours.strap",
                "after {slow} and {stop} s; vmax rose by {rise} m/s",
                slow=round(fell_s, 1),
                stop=round(fell_s + stood_s, 1),
                rise=round(self._rise_mps, 2),
            ),
            self._rise_mps <= 0.0,
        )
        self._is_faulty, self._has_contact = False, True
        trial.say(message("case.strap_on", "the strap is on again"))
        await trial.until(HEART_RATE_IS_VALID, lambda: self.heart_rate_bpm is not None, PATIENCE_S)
        await trial.reset()
        await trial.calm(DRIVES_AGAIN, lambda: self.chair.linear_mps > 0.1, PATIENCE_S)


CASE: Final = Case(
    name="wheelchair",
    summary="A wheelchair steered by leaning, slower while the heart beats fast.",
    robot="wheelchair-1",
    category="wheelchair",
    make=WheelchairMachine,
    sensors=(
        Sensor(
            "case-wheelchair",
            {
                "signals": ["heartRate", "pressureMap"],
                "rates_hz": {"pressureMap": 25.0},
                "packet_s": 0.1,
                "rest_bpm": 65.0,
                "max_bpm": 185.0,
            },
        ),
    ),
    person_settings={
        "restBpm": 65.0,
        "maximumBpm": 185.0,
        "freeBpm": FREE_BPM,
        "strainedBpm": STRAINED_BPM,
        "leastFraction": 0.0,
    },
)
