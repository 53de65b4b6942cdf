"""The case of the nocturnal bed: ROS4HC, section 5.3."""

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from services.assistive_devices.machine import Case, Machine, MachineState, Seen
from services.assistive_devices.machines.bed.controller import Bed, Signals
from services.assistive_devices.machines.bed.simulation import Frame, Sleeper
from services.assistive_devices.model.sensor import Sensor
from services.assistive_devices.trial import Trial

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
        movement = body.number(f"movement@{RADAR}", now_s, MOVEMENT_MAX_AGE_S)
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
        await trial.until("a valid heart rate", lambda: self.heart_rate_bpm is not None, PATIENCE_S)
        await trial.permission(PATIENCE_S)
        await trial.until("somebody lies", lambda: self.is_lying, PATIENCE_S)
        trial.say(f"somebody lies ({self.position}), {self.heart_rate_bpm or 0:.0f} bpm; the bed begins")
        self.start()
        await trial.calm("the bed rocks", lambda: self.frame.amplitude > 0.2, PATIENCE_S)
        await self._excite(trial)
        if duration_s >= SHORT_S:
            await self._breathe_not(trial)
            await self._lose_sensor(trial)
        await self._be_restless(trial)
        left_s = duration_s - (time.monotonic() - began_s)
        if duration_s >= SHORT_S and left_s > 0:
            trial.say(f"the sleeper rests for another {left_s:.0f} s")
            await trial.until("the end", lambda: time.monotonic() - began_s >= duration_s, left_s + 60)
        self.stop()
        trial.compare("trial", "5 min", f"{time.monotonic() - began_s:.0f} s")

    async def _excite(self, trial: Trial) -> None:
        """Let the heart beat faster, and see the period fall within its slew."""
        calm_bpm, calm_s = self.heart_rate_bpm or 0.0, self.controller.period_s
        self.sleeper = replace(self.sleeper, effort=EXCITED_EFFORT)
        await trial.until("a faster heart", lambda: (self.heart_rate_bpm or 0) >= calm_bpm + 10, PATIENCE_S)
        await trial.until("faster rocking", lambda: self.controller.period_s <= calm_s - 0.3, PATIENCE_S)
        bpm, period_s = self.heart_rate_bpm or 0.0, self.controller.period_s
        trial.say(f"{calm_bpm:.0f} to {bpm:.0f} bpm: rocking in {calm_s:.2f} s, then in {period_s:.2f} s")
        self.sleeper = replace(self.sleeper, effort=0.0)
        trial.compare(
            "a faster heart rocks faster",
            "yes (figure 5c, no figures)",
            f"{calm_bpm:.0f} bpm {calm_s:.2f} s, {bpm:.0f} bpm {period_s:.2f} s",
            period_s < calm_s,
        )
        given = self.controller.parameters
        trial.compare(
            "greatest change of the period (positive feedback)",
            "(not bounded)",
            f"{self._slew_s_per_s:.3f} s a second",
            self._slew_s_per_s <= given.period_slew_s_per_s + 1e-6,
        )

    async def _breathe_not(self, trial: Trial) -> None:
        before, known_s = self.apnoeas, time.monotonic()
        trial.say("the sleeper calms down")
        await trial.until("a calm minute", lambda: time.monotonic() - known_s > CALM_S, 2 * CALM_S)
        trial.say(f"an apnoea of {APNOEA_S:.0f} s")
        self.sleeper = replace(self.sleeper, is_breathing=False)
        began_s = time.monotonic()
        await trial.until("the pause", lambda: time.monotonic() - began_s >= APNOEA_S, 2 * APNOEA_S)
        self.sleeper = replace(self.sleeper, is_breathing=True).turn("lyingLeft")
        seconds = await trial.until("the event is found", lambda: self.apnoeas > before, PATIENCE_S)
        await trial.until("the new position", lambda: self.position == "left", PATIENCE_S)
        trial.say(f"found {seconds:.0f} s after it ended; the sleeper has turned to the left")
        trial.compare(
            "an apnoea is found, and ends with a turn",
            "dip and rise of the heart rate",
            f"{self.apnoeas - before} found, now on the {self.position} side",
            self.apnoeas > before,
        )
        is_calm = not self.controller.is_restless
        trial.compare(
            "a turn does not stop the bed", "yes (moving mean)", "yes" if is_calm else "no", is_calm
        )

    def _stands(self) -> bool:
        return self.frame.amplitude < MIN_AMPLITUDE

    async def _lose_sensor(self, trial: Trial) -> None:
        trial.say("the heart rate is lost")
        self._has_contact = False
        seconds = await trial.until("the bed stands", self._stands, PATIENCE_S)
        lifted = self.frame.backrest_deg
        self._has_contact = True
        trial.compare(
            "a lost heart rate stops the rocking",
            "(not in the paper)",
            f"after {seconds:.1f} s, backrest {lifted:.0f}°",
            lifted < 1.0,
        )
        await trial.until("a valid heart rate", lambda: self.heart_rate_bpm is not None, PATIENCE_S)
        await trial.calm("the bed rocks again", lambda: self.frame.amplitude > MIN_AMPLITUDE, PATIENCE_S)

    async def _be_restless(self, trial: Trial) -> None:
        trial.say("the sleeper becomes restless")
        self.sleeper = replace(self.sleeper, is_restless=True)
        noticed_s = await trial.until("restlessness", lambda: self.controller.is_restless, PATIENCE_S)
        await trial.until("the bed stands", lambda: self.controller.amplitude == 0.0, PATIENCE_S)
        rising_s = await trial.until("the backrest is up", lambda: self.frame.backrest_deg > 44.0, PATIENCE_S)
        self.sleeper = replace(self.sleeper, is_restless=False)
        trial.say(f"stopped after {noticed_s:.1f} s; the backrest rose in {rising_s:.1f} s")
        given = self.controller.parameters
        trial.compare(
            "restlessness stops the rocking and lifts the backrest",
            "to 45°",
            f"to {self.frame.backrest_deg:.0f}° at {self._lift_deg_per_s:.1f}° a second",
            self._lift_deg_per_s <= given.backrest_deg_per_s + 1e-6,
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
