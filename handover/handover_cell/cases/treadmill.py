"""`handover case treadmill --once`: the study of the trainer on a clock of its own, faster than life.

Three simulated people walk for ten minutes each, one after the other. Their heart rates come from the samples
of simulated sensors through drivers, guards, analysis, fusion and limits of human state, and the controller
ages the limits; only the clock is simulated. The same seed gives the same figures. After consent the language
model of the settings words what the trainer says; the decisions, and so the figures, are the same.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from handover.control.speed_limits import SpeedLimits
from handover.errors import UsageError
from handover_body.cases.sensed_person import DEFAULT_START_S, SensedPerson
from handover_body.drivers.simulated.driver import SimulatedDriver, SimulatedSettings
from handover_body.drivers.simulated.person import SimulatedPerson
from handover_body.limits.curve import LimitCurve
from handover_body.model.cardiovascular import Physiology
from handover_body.model.signals import SignalKind
from handover_cases.machines.treadmill.case import HEART_RATE_MAX_AGE_S, model_of
from handover_cases.machines.treadmill.coach import Decision
from handover_cases.machines.treadmill.report import compare
from handover_cases.machines.treadmill.simulation import Habits, SimulatedWalker
from handover_cases.machines.treadmill.training import Plan, Training
from handover_cases.machines.treadmill.wording import Words, template
from handover_cases.settings import AssistiveSettings
from handover_cases.trial import Trial
from handover_cell.progress import Say
from handover_datamodels.streams import SpeedLimitReport

SEED: Final = 1
STEP_S: Final = 0.05
PACKET_STEPS: Final = 5
REST_S: Final = 40.0
"""The person stands before the training: the heart rate becomes known, and the limit rises."""
REPORT_PERIOD_S: Final = 0.25
SIGNALS: Final = (SignalKind.ECG, SignalKind.ACCELERATION, SignalKind.RESPIRATION)


@dataclass(frozen=True, slots=True)
class Participant:
    """A simulated person of the study."""

    name: str
    body: Physiology
    habits: Habits


PARTICIPANTS: Final = (
    Participant("30 years, active", Physiology.of_age(30, is_active=True, rest_bpm=66.0), Habits(0.9)),
    Participant("55 years, sedentary", Physiology.of_age(55), Habits(0.7)),
    Participant("72 years, sedentary", Physiology.of_age(72), Habits(0.6)),
)


Wording = Callable[[Decision, int], Words]
"""Words the decision with a number, counted from 0."""


def _by_template(decision: Decision, number: int) -> Words:
    return Words(template(decision, number), "template")


def perform_study(duration_s: float | None, say: Say, *, consents_to_model: bool = False) -> Trial:
    """Let all participants walk for as long as in the paper, or `duration_s`; return the figures.

    After consent the language model of the settings is asked. Raises `UsageError` if there is none.
    """
    try:
        plan = Plan() if duration_s is None else Plan(duration_s)
    except ValueError as error:
        raise UsageError(str(error)) from None
    trial = Trial(plan.duration_s)
    if not consents_to_model:
        perform(plan, SEED, say, trial)
    else:
        model = model_of(AssistiveSettings.load())
        if model is None:
            raise UsageError("no language model is set; set HANDOVER_TRAINER_MODEL_URL and its name")
        with asyncio.Runner() as runner:

            def word(decision: Decision, number: int) -> Words:
                return runner.run(model.word(decision, number, plan.language))

            perform(plan, SEED, say, trial, word)
            runner.run(model.close())
    trial.is_running = False
    return trial


def perform(plan: Plan, seed: int, say: Say, trial: Trial, word: Wording = _by_template) -> None:
    """Let all participants walk, the first with the seed `seed`, and compare the figures of each."""
    zone = plan.zone
    for number, participant in enumerate(PARTICIPANTS):
        say(f"{participant.name}: {plan.duration_s / 60:g} min, {zone.low_bpm:g} to {zone.high_bpm:g} bpm")
        training = walk(participant, plan, seed + number, say, word)
        compare(trial, training.figures(), plan, training.belt.reason, participant.name)


def walk(participant: Participant, plan: Plan, seed: int, say: Say, word: Wording = _by_template) -> Training:
    """Return the training of one person, after it has ended and the belt stands."""
    settings = SimulatedSettings(
        signals=SIGNALS, pace=0, start_s=DEFAULT_START_S, seed=seed, packet_s=PACKET_STEPS * STEP_S
    )
    driver = SimulatedDriver("strap", settings, SimulatedPerson(seed, body=participant.body))
    person = SensedPerson(driver, LimitCurve(plan.zone.high_bpm + 10, plan.zone.high_bpm + 40, 0.0))
    person.body.posture = "standing"
    person.body.walk(0.0)
    training = Training(SimulatedWalker(seed, participant.habits), now_s=person.now_s)
    limits = SpeedLimits((), person.now_s)
    started = False
    steps = 0
    while not started or training.is_running or training.belt.speed_mps > 0:
        steps += 1
        now_s = DEFAULT_START_S + steps * STEP_S
        if steps % PACKET_STEPS == 0:
            person.body.walk(training.walker.walk_mps)
            person.step()
            limits.receive(_report(person, now_s), now_s, now_s)
        if not started and now_s - DEFAULT_START_S >= REST_S:
            started = training.start(plan, now_s)
        decision = training.step(now_s, STEP_S, _heart(person, now_s), _allowed_mps(limits, training, now_s))
        if decision is not None:
            bpm = training.record[-1].bpm
            heart_rate = "no heart rate" if bpm is None else f"{bpm:3.0f} bpm"
            at_s = now_s - (training.began_s or 0.0)
            words = word(decision, len(training.decisions) - 1)
            by = {"model": " (model)", "template": f" ({words.problem})" if words.problem else ""}
            spoken = f"{words.text}{by[words.source]}"
            say(f"{at_s:6.1f} s  {heart_rate}, {training.belt.speed_mps:.2f} m/s: {spoken}")
            training.follow(decision.advice)
    return training


def _report(person: SensedPerson, now_s: float) -> SpeedLimitReport:
    limit = person.limit
    reason = limit.reason(now_s)
    return SpeedLimitReport(
        source="body-case", stamp=now_s, fraction=limit.fraction, reason=reason, period=REPORT_PERIOD_S
    )


def _heart(person: SensedPerson, now_s: float) -> tuple[float, float] | None:
    value = person.heart_rate
    if value is None or now_s - value.at_s > HEART_RATE_MAX_AGE_S:
        return None
    return float(value.value), value.at_s


def _allowed_mps(limits: SpeedLimits, training: Training, now_s: float) -> float:
    highest_mps = training.belt.settings.max_speed_mps
    allowed = limits.allowed(now_s)
    return min((limit.pace(highest_mps) for limit in allowed), default=0.0) * highest_mps
