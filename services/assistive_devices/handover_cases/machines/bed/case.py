"""The case of the nocturnal bed: ROS4HC, section 5.3."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from handover.messages import message
from handover_cases.machine import Case, Machine, MachineState, Seen
from handover_cases.machines.bed.controller import Bed, Signals
from handover_cases.machines.bed.simulation import Frame, Sleeper
from handover_cases.model.command import Command, NumberCommand
from handover_cases.model.sensor import Sensor
from handover_cases.trial import HEART_RATE_IS_VALID, NOT_IN_PAPER, TIME_IS_OVER, Trial

RADAR: Final = "case-bed"
PAPER_DURATION_S: Final = 300.0
SHORT_S: Final = 120.0
"""A trial that is to be shorter leaves out the apnoea and the sensor that is silent."""
HEART_MAX_AGE_S: Final = 3.0
MOVEMENT_MAX_AGE_S: Final = 5.0
POSTURE_MAX_AGE_S: Final = 5.0
CALM_S: Final = 90.0
APNOEA_S: Final = 25.0
EXCITED_EFFORT: Final = 0.25
MIN_AMPLITUDE: Final = 0.02
PATIENCE_S: Final = 240.0
BED_STANDS: Final = message("case.bed.wait.stands", "the bed stands")


class BedMachine(Machine):
    """The controller, the simulated bed, and the sleeper."""

    def __init__(self) -> None:
        self.controller = Bed()
        self.frame = Frame()
        self.sleeper = Sleeper()
        self.heart_rate_bpm: float | None = None
        self.position = ""
        self.is_lying = False
        self.apnoeas = 0
        self._fraction = 0.0
        self._reason = ""
        self._has_contact = True
        self._last_event = float("-inf")
        self._slew_s_per_s = 0.0
        self._lift_deg_per_s = 0.0

    def start(self) -> None:
        self.controller = self.controller.start()

    def stop(self) -> None:
        self.controller = self.controller.stop()

    def step(self, seen: Seen) -> None:
        body, now_s = seen.body, seen.now_s
        self.heart_rate_bpm = body.number("heartRate", now_s, HEART_MAX_AGE_S)
        position = body.text("sleepPosition", now_s, POSTURE_MAX_AGE_S)
        posture = body.text("posture", now_s, POSTURE_MAX_AGE_S)
        self.position, self.is_lying = position or "", position is not None and posture == "lying"
        self._count_events(seen)
        self._fraction, self._reason = seen.allowed.fraction, str(seen.allowed.reason)
        movement = body.number(f"bodyMovement@{RADAR}", now_s, MOVEMENT_MAX_AGE_S)
        signals = Signals(self.heart_rate_bpm, movement, self.is_lying, self._fraction)
        before, self.controller = self.controller, self.controller.step(signals, seen.dt_s)
        if seen.dt_s > 0:
            slew = abs(self.controller.period_s - before.period_s) / seen.dt_s
            lift = abs(self.controller.backrest_deg - before.backrest_deg) / seen.dt_s
            self._slew_s_per_s = max(self._slew_s_per_s, slew)
            self._lift_deg_per_s = max(self._lift_deg_per_s, lift)
        made = self.controller
        self.frame = self.frame.step(made.period_s, made.amplitude, made.backrest_deg, seen.dt_s)
        self.sleeper = self.sleeper.step(seen.dt_s)

    def _count_events(self, seen: Seen) -> None:
        event = seen.body.readings.get("apnoeaEvent")
        if event is not None and event.at_s > self._last_event + 1.0:
            self.apnoeas += self._last_event > float("-inf") or seen.now_s - event.at_s < 60
            self._last_event = event.at_s

    def acts(self) -> Mapping[str, Any]:
        sleeper = self.sleeper
        return {
            "effort": sleeper.effort,
            "posture": sleeper.posture,
            "isBreathing": sleeper.is_breathing,
            "movement": sleeper.movement,
            "contact": self._has_contact,
        }

    def commands(self) -> Sequence[Command]:
        made = self.controller
        return (
            NumberCommand("/bed/rocking_period", made.period_s),
            NumberCommand("/bed/rocking_amplitude", made.amplitude),
            NumberCommand("/bed/backrest", math.radians(made.backrest_deg)),
        )

    def state(self) -> MachineState:
        made, frame = self.controller, self.frame
        is_rocking = frame.amplitude > MIN_AMPLITUDE
        if made.is_restless:
            raised = made.backrest_deg >= made.parameters.raised_deg
            state, reason = ("raised" if raised else "lifting"), "the sleeper is restless"
        elif not made.is_enabled:
            state, reason = ("stopping" if is_rocking else "idle"), "not started"
        elif self.heart_rate_bpm is None:
            state, reason = "stopped", "no valid heart rate"
        elif not self.is_lying:
            state, reason = "waiting", "nobody is known to lie here"
        elif made.backrest_deg > 1.0:
            state, reason = "lowering", ""
        else:
            state, reason = ("rocking" if self._fraction > 0 else "stopped"), self._reason
        mean = made.mean_movement
        values = {
            "period": (made.period_s, "SEC"),
            "amplitude": (frame.amplitude, "P1"),
            "backrest": (frame.backrest_deg, "DD"),
            "apnoeas": (float(self.apnoeas), ""),
        }
        chart = {"period": made.period_s, "amplitude": frame.amplitude, "backrest": frame.backrest_deg}
        if mean is not None:
            values["meanMovement"] = (mean, "")
            chart["meanMovement"] = mean
        if self.heart_rate_bpm is not None:
            chart["heartRate"] = self.heart_rate_bpm
        return MachineState(state, reason, values, chart, is_rocking or state in {"lifting", "lowering"})

    def describe(self) -> Mapping[str, Any]:
        return {"sleepPosition": self.position}

    async def perform_trial(self, trial: Trial) -> None:
        duration_s = trial.duration_s or PAPER_DURATION_S
        self.sleeper, self.controller, self.frame = Sleeper(), Bed(), Frame()
        self._slew_s_per_s = self._lift_deg_per_s = 0.0
        self.apnoeas = 0
        began_s = time.monotonic()
        await trial.until(HEART_RATE_IS_VALID, lambda: self.heart_rate_bpm is not None, PATIENCE_S)
        await trial.permission(PATIENCE_S)
        lies = message("case.bed.wait.lies", "somebody lies")
        await trial.until(lies, lambda: self.is_lying, PATIENCE_S)
        trial.say(
            message(
                "case.bed.begins",
                "somebody lies, {bpm} bpm; the bed begins",
                bpm=round(self.heart_rate_bpm or 0),
            )
        )
        self.start()
        await trial.calm(
            message("case.bed.wait.rocks", "the bed rocks"), lambda: self.frame.amplitude > 0.2, PATIENCE_S
        )
        await self._excite(trial)
        if duration_s >= SHORT_S:
            await self._breathe_not(trial)
            await self._lose_sensor(trial)
        await self._be_restless(trial)
        left_s = duration_s - (time.monotonic() - began_s)
        if duration_s >= SHORT_S and left_s > 0:
            trial.say(
                message("case.bed.rests", "the sleeper rests for another {seconds} s", seconds=round(left_s))
            )
            await trial.until(TIME_IS_OVER, lambda: time.monotonic() - began_s >= duration_s, left_s + 60)
        self.stop()
        trial.compare(
            message("case.figure.trial", "trial"),
            message("case.bed.paper.trial", "5 min"),
            message("case.bed.ours.trial", "{seconds} s", seconds=round(time.monotonic() - began_s)),
        )

    async def _excite(self, trial: Trial) -> None:
        """Let the heart beat faster, and see the period fall within its slew."""
        calm_bpm, calm_s = self.heart_rate_bpm or 0.0, self.controller.period_s
        self.sleeper = replace(self.sleeper, effort=EXCITED_EFFORT)
        faster = message("case.bed.wait.heart", "a faster heart")
        await trial.until(faster, lambda: (self.heart_rate_bpm or 0) >= calm_bpm + 10, PATIENCE_S)
        rocking = message("case.bed.wait.rocking", "faster rocking")
        await trial.until(rocking, lambda: self.controller.period_s <= calm_s - 0.3, PATIENCE_S)
        bpm, period_s = self.heart_rate_bpm or 0.0, self.controller.period_s
        trial.say(
            message(
                "case.bed.excited",
                "{calm} to {bpm} bpm: rocking in {before} s, then in {after} s",
                calm=round(calm_bpm),
                bpm=round(bpm),
                before=round(calm_s, 2),
                after=round(period_s, 2),
            )
        )
        self.sleeper = replace(self.sleeper, effort=0.0)
        trial.compare(
            message("case.bed.figure.faster", "a faster heart rocks faster"),
            message("case.bed.paper.faster", "yes (figure 5c, no figures)"),
            message(
                "case.bed.ours.faster",
                "{calm} bpm {before} s, {bpm} bpm {after} s",
                calm=round(calm_bpm),
                bpm=round(bpm),
                before=round(calm_s, 2),
                after=round(period_s, 2),
            ),
            period_s < calm_s,
        )
        bounds = self.controller.parameters
        trial.compare(
            message("case.bed.figure.slew", "greatest change of the period (positive feedback)"),
            message("case.bed.paper.slew", "(not bounded)"),
            message("case.bed.ours.slew", "{slew} s a second", slew=round(self._slew_s_per_s, 3)),
            self._slew_s_per_s <= bounds.period_slew_s_per_s + 1e-6,
        )

    async def _breathe_not(self, trial: Trial) -> None:
        before, known_s = self.apnoeas, time.monotonic()
        trial.say(message("case.bed.calms", "the sleeper calms down"))
        calm = message("case.bed.wait.calm", "a calm minute")
        await trial.until(calm, lambda: time.monotonic() - known_s > CALM_S, 2 * CALM_S)
        trial.say(message("case.bed.apnoea", "an apnoea of {seconds} s", seconds=round(APNOEA_S)))
        self.sleeper = replace(self.sleeper, is_breathing=False)
        began_s = time.monotonic()
        pause = message("case.bed.wait.pause", "the pause")
        await trial.until(pause, lambda: time.monotonic() - began_s >= APNOEA_S, 2 * APNOEA_S)
        self.sleeper = replace(self.sleeper, is_breathing=True).turn("lyingLeft")
        text = message("case.bed.wait.found", "the event is found")
        seconds = await trial.until(text, lambda: self.apnoeas > before, PATIENCE_S)
        position = message("case.bed.wait.position", "the new position")
        await trial.until(position, lambda: self.position == "left", PATIENCE_S)
        trial.say(
            message(
                "case.bed.found",
                "found {seconds} s after it ended; the sleeper has turned to the left",
                seconds=round(seconds),
            )
        )
        trial.compare(
            message("case.bed.figure.apnoea", "an apnoea is found, and ends with a turn"),
            message("case.bed.paper.apnoea", "dip and rise of the heart rate"),
            message(
                "case.bed.ours.apnoea", "{count} found, now on the left side", count=self.apnoeas - before
            ),
            self.apnoeas > before,
        )
        is_calm = not self.controller.is_restless
        trial.compare(
            message("case.bed.figure.turn", "a turn does not stop the bed"),
            message("case.bed.paper.turn", "yes (moving mean)"),
            message("case.yes", "yes") if is_calm else message("case.no", "no"),
            is_calm,
        )

    def _stands(self) -> bool:
        return self.frame.amplitude < MIN_AMPLITUDE

    async def _lose_sensor(self, trial: Trial) -> None:
        trial.say(message("case.bed.lost", "the heart rate is lost"))
        self._has_contact = False
        seconds = await trial.until(BED_STANDS, self._stands, PATIENCE_S)
        lifted = self.frame.backrest_deg
        self._has_contact = True
        trial.compare(
            message("case.bed.figure.lost", "a lost heart rate stops the rocking"),
            NOT_IN_PAPER,
            message(
                "case.bed.ours.lost",
                "after {seconds} s, backrest {degrees}°",
                seconds=round(seconds, 1),
                degrees=round(lifted),
            ),
            lifted < 1.0,
        )
        await trial.until(HEART_RATE_IS_VALID, lambda: self.heart_rate_bpm is not None, PATIENCE_S)
        again = message("case.bed.wait.again", "the bed rocks again")
        await trial.calm(again, lambda: self.frame.amplitude > MIN_AMPLITUDE, PATIENCE_S)

    async def _be_restless(self, trial: Trial) -> None:
        trial.say(message("case.bed.restless", "the sleeper becomes restless"))
        self.sleeper = replace(self.sleeper, is_restless=True)
        restless = message("case.bed.wait.restless", "restlessness")
        noticed_s = await trial.until(restless, lambda: self.controller.is_restless, PATIENCE_S)
        await trial.until(BED_STANDS, lambda: self.controller.amplitude == 0.0, PATIENCE_S)
        is_up = message("case.bed.wait.up", "the backrest is up")
        rising_s = await trial.until(is_up, lambda: self.frame.backrest_deg > 44.0, PATIENCE_S)
        self.sleeper = replace(self.sleeper, is_restless=False)
        trial.say(
            message(
                "case.bed.lifted",
                "stopped after {noticed} s; the backrest rose in {rising} s",
                noticed=round(noticed_s, 1),
                rising=round(rising_s, 1),
            )
        )
        bounds = self.controller.parameters
        trial.compare(
            message("case.bed.figure.restless", "restlessness stops the rocking and lifts the backrest"),
            message("case.bed.paper.restless", "to 45°"),
            message(
                "case.bed.ours.restless",
                "to {degrees}° at {speed}° a second",
                degrees=round(self.frame.backrest_deg),
                speed=round(self._lift_deg_per_s, 1),
            ),
            self._lift_deg_per_s <= bounds.backrest_deg_per_s + 1e-6,
        )


CASE: Final = Case(
    name="bed",
    summary="A bed that rocks with the heart rate, and lifts the backrest of a restless sleeper.",
    robot="bed-1",
    category="bed",
    make=BedMachine,
    sensors=(
        Sensor(
            RADAR,
            {
                "signals": ["heartRate", "breathingRate", "movement"],
                "packet_s": 0.25,
                "rest_bpm": 56.0,
                "max_bpm": 180.0,
            },
        ),
        Sensor("case-bed-trunk", {"signals": ["acceleration"], "packet_s": 0.5}, frozenset({"posture"})),
    ),
    person_settings={
        "restBpm": 56.0,
        "maximumBpm": 180.0,
        "freeBpm": 100.0,
        "strainedBpm": 140.0,
        "leastFraction": 0.0,
    },
)
