"""The case of the treadmill trainer: ROS4HC, section 5.2."""

import asyncio
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

from pydantic import ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from handover.errors import Problem, UsageError
from handover.formats.strict_json import StrictModel
from handover.formats.validation import fault_text
from handover.messages import Message, message, with_code
from handover_cases.machine import Case, Machine, MachineContext, MachineState, Seen
from handover_cases.machines.treadmill.belt import BeltState, StopReason
from handover_cases.machines.treadmill.coach import Advice, Decision, Intensity, Reason
from handover_cases.machines.treadmill.report import compare
from handover_cases.machines.treadmill.session_log import SessionLog, SessionRow, new_id
from handover_cases.machines.treadmill.simulation import SimulatedWalker
from handover_cases.machines.treadmill.training import (
    DEFAULT_DURATION_S,
    MAX_DURATION_S,
    MIN_DURATION_S,
    Plan,
    Training,
)
from handover_cases.machines.treadmill.wording import ModelWording, Words, template
from handover_cases.model.command import Command, VelocityCommand
from handover_cases.model.sensor import Sensor
from handover_cases.settings import AssistiveSettings
from handover_cases.trial import BODY_IS_CALM, HEART_RATE_IS_VALID, LIMIT_FALLS, NOT_IN_PAPER, Trial
from handover_datamodels.times import iso

HEART_RATE_MAX_AGE_S: Final = 5.0
SHOWN_INTERVENTIONS: Final = 20
PATIENCE_S: Final = 240.0
BELT_STANDS: Final = message("case.treadmill.wait.stands", "the belt stands")
CALM_FRACTION: Final = 0.95
STRAP_TEST_S: Final = 60.0
"""A trial that is to be shorter leaves out the strap that comes off."""
REST_BPM, MAXIMUM_BPM, VO2_MAX = 70.0, 169.5, 27.3
"""The simulated person: 55 years, not trained (`Physiology.of_age(55)` of human state)."""

REASONS: Final[dict[StopReason | None, Message]] = {
    None: message("treadmill.reason.none", "not started"),
    StopReason.PERSON: message("treadmill.reason.person", "a person stopped it"),
    StopReason.LOST: message("treadmill.reason.lost", "the walker is not seen"),
    StopReason.FRONT_END: message("treadmill.reason.front", "the walker is too near the front end"),
    StopReason.REAR_END: message("treadmill.reason.rear", "the walker is too near the rear end"),
    StopReason.LIMIT: message("treadmill.reason.limit", "the limit of the body"),
    StopReason.TIME: message("treadmill.reason.time", "the training is over"),
}


class TrainingOptions(StrictModel):
    """What the person sets before a training. Without `consentsToModel` no language model is asked."""

    model_config = ConfigDict(extra="forbid", frozen=True, alias_generator=to_camel, populate_by_name=True)

    duration_s: float = Field(DEFAULT_DURATION_S, ge=MIN_DURATION_S, le=MAX_DURATION_S)
    intensity: Intensity = Intensity.LIGHT
    language: str = Field("en", pattern="^(en|de|fi)$")
    consents_to_model: bool = False

    def plan(self) -> Plan:
        """Return the plan."""
        return Plan(self.duration_s, self.intensity, self.language, self.consents_to_model)


class _Intervention:
    """An intervention as people see it; the words come later."""

    def __init__(self, number: int, at_us: int, advice: Advice, reason: Reason) -> None:
        self.number, self.at_us, self.advice, self.reason = number, at_us, advice, reason
        self.words: Words | None = None

    def shown(self) -> dict[str, Any]:
        words = self.words
        return {
            "number": self.number,
            "at": iso(datetime.fromtimestamp(self.at_us / 1e6, UTC)),
            "advice": self.advice.value,
            "reason": self.reason.value,
            "source": None if words is None else words.source,
            **({} if words is None else with_code("text", words.text)),
        }


class TreadmillMachine(Machine):
    """The belt with its simulated walker, the coach, and the log of what it said."""

    def __init__(self) -> None:
        self.training = Training(SimulatedWalker(seed=2), now_s=time.monotonic())
        self.fraction = 0.0
        self.heart: tuple[float, float] | None = None
        self._now_s = time.monotonic()
        self._allowed_reason = ""
        self._needs_reset = False
        self._plan = Plan()
        self._session: str | None = None
        self._interventions: deque[_Intervention] = deque(maxlen=SHOWN_INTERVENTIONS)
        self._has_contact = True
        self._log: SessionLog | None = None
        self._keep_days = 0.0
        self._model: ModelWording | None = None
        self._writes: asyncio.Queue[Callable[[], Any]] = asyncio.Queue()
        self._to_word: asyncio.Queue[tuple[str, Plan, _Intervention, Decision]] = asyncio.Queue()

    def prepare(self, context: MachineContext) -> None:
        self._log = SessionLog(context.engine)
        self._keep_days = context.settings.trainer_log_days
        self._model = model_of(context.settings)

    def configure(self, options: Mapping[str, Any]) -> None:
        try:
            self._plan = TrainingOptions.model_validate(options).plan()
        except ValidationError as error:
            wrong = fault_text(error, "training")
            raise Problem.translated(
                422,
                "Invalid training",
                "treadmill.options",
                "the training cannot be so: {wrong}",
                wrong=wrong,
            ) from None
        if self._plan.consents_to_model and self._model is None:
            raise Problem.translated(
                409,
                "No language model",
                "treadmill.no_model",
                "no language model is set, so there is nothing to consent to; set "
                "HANDOVER_TRAINER_MODEL_URL, or start without it",
            )

    def start(self) -> None:
        if self.training.is_running or not self.training.start(self._plan, self._now_s):
            raise Problem.translated(
                409, "Belt moves", "treadmill.moves", "the belt still moves; wait until it stands"
            )
        self._session = new_id()
        plan = self._plan
        row = SessionRow(
            self._session, _now_us(), plan.duration_s, plan.intensity, plan.language, plan.consents_to_model
        )
        self._interventions.clear()
        self._write(lambda log: log.begin(row))

    def stop(self) -> None:
        self.training.stop(StopReason.PERSON)

    async def saved(self) -> None:
        done = asyncio.Event()
        self._writes.put_nowait(done.set)
        await done.wait()

    def step(self, seen: Seen) -> None:
        self._now_s = seen.now_s
        self.fraction, self._allowed_reason = seen.allowed.fraction, str(seen.allowed.reason)
        self._needs_reset = seen.allowed.needs_reset
        rate = seen.body.number("heartRate", seen.now_s, HEART_RATE_MAX_AGE_S)
        self.heart = None if rate is None else (rate, seen.body.readings["heartRate"].at_s)
        settings = self.training.belt.settings
        allowed_mps = seen.allowed.pace(settings.max_speed_mps) * settings.max_speed_mps
        decision = self.training.step(seen.now_s, seen.dt_s, self.heart, allowed_mps)
        if decision is not None:
            self._decided(decision)
        if self._session is not None and self.training.belt.state is BeltState.STOPPED:
            self._ended(self._session)

    def _decided(self, decision: Decision) -> None:
        session = self._session
        if session is None:
            return
        number = len(self.training.decisions)
        shown = _Intervention(number, _now_us(), decision.advice, decision.reason)
        self._write(lambda log: log.add(session, number, decision, shown.at_us))
        self._to_word.put_nowait((session, self.training.plan, shown, decision))

    def _ended(self, session: str) -> None:
        belt, self._session = self.training.belt, None
        reason = belt.reason or StopReason.PERSON
        self._write(lambda log: log.end(session, _now_us(), reason.value, belt.distance_m))

    def _write(self, act: Callable[[SessionLog], None]) -> None:
        if self._log is not None:
            self._writes.put_nowait(partial(act, self._log))

    async def work(self) -> None:
        """Write the log and word decisions. The belt never waits for either."""
        if self._log is not None:
            await asyncio.to_thread(self._log.open, _now_us(), self._keep_days)
            self._interventions.extend(await asyncio.to_thread(_last_of, self._log))
        async with asyncio.TaskGroup() as group:
            group.create_task(self._keep_writing())
            group.create_task(self._keep_wording())

    async def _keep_writing(self) -> None:
        while True:
            write = await self._writes.get()
            await asyncio.to_thread(write) if isinstance(write, partial) else write()

    async def _keep_wording(self) -> None:
        while True:
            session, plan, shown, decision = await self._to_word.get()
            number = shown.number - 1
            words = Words(template(decision, number), "template")
            if plan.consents_to_model and self._model is not None:
                words = await self._model.word(decision, number, plan.language)
            self._write(lambda log, s=session, n=shown.number, w=words: log.word(s, n, w))  # type: ignore[misc]
            await self.saved()
            shown.words = words
            if session == self._session:
                self._interventions.append(shown)
                self.training.follow(decision.advice)

    def acts(self) -> Mapping[str, Any]:
        walk_mps = round(self.training.walker.walk_mps, 2)
        return {"walkingMps": walk_mps, "posture": "standing", "contact": self._has_contact}

    def commands(self) -> Sequence[Command]:
        speed_mps = self.training.belt.speed_mps
        if not self.training.is_running and speed_mps == 0.0:
            return ()
        return (VelocityCommand("/treadmill/cmd_vel", speed_mps),)

    def state(self) -> MachineState:
        belt = self.training.belt
        zone = self.training.plan.zone
        left_s = self.training.time_left_s(self._now_s)
        allowed_mps = self.fraction * belt.settings.max_speed_mps
        values = {
            "speed": (belt.speed_mps, "MTS"),
            "allowed": (allowed_mps, "MTS"),
            "distance": (belt.distance_m, "MTR"),
            "place": (round(belt.place_m, 2) + 0.0, "MTR"),  # no -0
            "timeLeft": (float(round(left_s)), "SEC"),
        }
        chart = {
            "speed": belt.speed_mps,
            "vmax": allowed_mps,
            "zoneLow": zone.low_bpm,
            "zoneHigh": zone.high_bpm,
        }
        if self.heart is not None:
            chart["heartRate"] = self.heart[0]
        is_limited = belt.state is BeltState.FOLLOWING or self._needs_reset
        reason = self._allowed_reason if is_limited else REASONS[belt.reason]
        return MachineState(belt.state.value, reason, values, chart, belt.speed_mps > 0)

    def describe(self) -> Mapping[str, Any]:
        plan = self.training.plan
        return {
            "trainer": {
                "durationS": plan.duration_s,
                "timeLeftS": round(self.training.time_left_s(self._now_s), 1),
                "intensity": plan.intensity.value,
                "language": plan.language,
                "consentsToModel": plan.consents_to_model,
                "hasModel": self._model is not None,
                "zone": {"lowBpm": plan.zone.low_bpm, "highBpm": plan.zone.high_bpm},
                **with_code("reason", REASONS[self.training.belt.reason]),
                "interventions": [intervention.shown() for intervention in self._interventions],
            }
        }

    async def perform_trial(self, trial: Trial) -> None:
        duration_s = min(max(trial.duration_s or DEFAULT_DURATION_S, MIN_DURATION_S), MAX_DURATION_S)
        self._has_contact = True
        await trial.until(HEART_RATE_IS_VALID, lambda: self.heart is not None, PATIENCE_S)
        await trial.permission(PATIENCE_S)
        await trial.calm(BODY_IS_CALM, lambda: self.fraction > CALM_FRACTION, PATIENCE_S)
        self.configure({"durationS": duration_s, "consentsToModel": trial.consents_to_model})
        self.start()
        trial.say(
            message(
                "case.treadmill.begins",
                "{bpm} bpm; the person begins to walk, for {seconds} s",
                bpm=round(self._bpm()),
                seconds=round(duration_s),
            )
        )
        news = message("case.treadmill.wait.words", "the next words, or the end")
        said = 0
        while self.training.is_running:
            await trial.until(news, partial(self._has_news, said), PATIENCE_S)
            for shown in [intervention for intervention in self._interventions if intervention.number > said]:
                said = shown.number
                trial.say(
                    message(
                        "case.treadmill.says",
                        "{bpm} bpm, {speed} m/s: {words}",
                        bpm=round(self._bpm()),
                        speed=round(self.training.belt.speed_mps, 2),
                        words="" if shown.words is None else shown.words.text,
                    )
                )
        await trial.until(BELT_STANDS, lambda: self._session is None, PATIENCE_S)
        ended_by = self.training.belt.reason
        compare(trial, self.training.figures(), self.training.plan, ended_by)
        if duration_s >= STRAP_TEST_S:
            await self._lose_strap(trial)

    def _has_news(self, said: int) -> bool:
        return not self.training.is_running or any(
            intervention.number > said for intervention in self._interventions
        )

    def _bpm(self) -> float:
        return 0.0 if self.heart is None else self.heart[0]

    async def _lose_strap(self, trial: Trial) -> None:
        trial.say(message("case.treadmill.strap_off", "another training: the strap slips off"))
        self.start()
        runs = message("case.treadmill.wait.runs", "the belt runs")
        await trial.until(runs, lambda: self.training.belt.speed_mps > 0.5, PATIENCE_S)
        self._has_contact = False
        fell_s = await trial.until(LIMIT_FALLS, lambda: self.fraction <= 0.25, PATIENCE_S)
        stood_s = await trial.until(BELT_STANDS, lambda: self._session is None, PATIENCE_S)
        trial.compare(
            message("case.treadmill.figure.strap", "strap off: slower by a ramp, then a stop"),
            NOT_IN_PAPER,
            message(
                "case.treadmill.ours.strap",
                "25 % after {slow} s, stands after {stop} s",
                slow=round(fell_s, 1),
                stop=round(fell_s + stood_s, 1),
            ),
            self.training.belt.reason is StopReason.LIMIT,
        )
        self._has_contact = True
        await trial.until(HEART_RATE_IS_VALID, lambda: self.heart is not None, PATIENCE_S)
        await trial.permission(PATIENCE_S)


def model_of(settings: AssistiveSettings) -> ModelWording | None:
    """Return the language model of the settings, None without one. Raises `UsageError`."""
    if not settings.trainer_model_url:
        return None
    key = settings.trainer_model_key
    try:
        return ModelWording(
            settings.trainer_model_url,
            settings.trainer_model_name,
            "" if key is None else key.get_secret_value(),
            settings.trainer_model_timeout_s,
        )
    except ValueError as error:
        raise UsageError(str(error)) from None


def _last_of(log: SessionLog) -> list[_Intervention]:
    """Return the interventions of the last session, to show them after a restart."""
    views = []
    for session in log.sessions()[:1]:
        for row in log.interventions(session.id)[-SHOWN_INTERVENTIONS:]:
            shown = _Intervention(row.number, row.at_us, row.advice, row.reason)
            shown.words = Words(row.text, row.source or "") if row.text else None
            views.append(shown)
    return views


def _now_us() -> int:
    return time.time_ns() // 1000


CASE: Final = Case(
    name="treadmill",
    summary="A treadmill that follows the walker, with a trainer for the heart rate.",
    robot="treadmill-1",
    category="treadmill",
    make=TreadmillMachine,
    sensors=(
        Sensor(
            "case-treadmill",
            {
                "signals": ["ecg", "acceleration", "respiration"],
                "packet_s": 0.25,
                "rest_bpm": REST_BPM,
                "max_bpm": MAXIMUM_BPM,
                "vo2_max": VO2_MAX,
                "seed": 2,
            },
        ),
    ),
    person_settings={
        "restBpm": REST_BPM,
        "maximumBpm": MAXIMUM_BPM,
        "freeBpm": 105.0,
        "strainedBpm": 135.0,
        "leastFraction": 0.0,
    },
)
