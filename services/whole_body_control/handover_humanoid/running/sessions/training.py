"""The session that runs: throws at the patient and their outcomes, or walking led by the patient's hands.

`tick` is called 50 times a second with the newest state of the robot. It pauses the session for its causes:
no input, tracking lost, out of bounds, too much force, a stop; a speed limit of 0 ends it. In each case the
robot finishes its step and stands on both feet, and it continues only when a person resumes the session.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any, Final
from uuid import uuid4

import numpy as np

from handover.errors import Problem
from handover.telemetry import get_logger
from handover_humanoid.behaviours.component_state import Behaviour
from handover_humanoid.patterns.regions import Side
from handover_humanoid.running.humanoid_control import HumanoidControl
from handover_humanoid.running.motion import NAMES
from handover_humanoid.running.sessions.juggling import Juggling
from handover_humanoid.running.sessions.signals import PatientSignals
from handover_humanoid.running.sessions.store import SessionStore
from handover_humanoid.sessions.catching import CatchRules
from handover_humanoid.sessions.difficulty import CatchingSpace, Difficulty, DifficultyRules
from handover_humanoid.sessions.exercise import (
    Application,
    EndReason,
    Exercise,
    Goal,
    PauseReason,
    State,
)
from handover_humanoid.sessions.report import juggling_report
from handover_humanoid.sessions.walking import WalkFigures

log = get_logger(__name__)

GRACE_S: Final = 5.0
"""After the start, before silence of the patient counts."""
BEHAVIOURS: Final[Mapping[Application, str]] = {"juggling": "juggling", "walking": "assistedWalking"}
_DOWN: Final = 4.0
_HOLDING: Final = 2.0


@dataclass(frozen=True, slots=True)
class SessionPlan:
    """What a therapist or a Task asks for; `person` is the id of an entity, None for nobody in particular."""

    application: Application
    goal: Goal
    person: str | None = None
    task: str | None = None
    rules: DifficultyRules = field(default_factory=DifficultyRules)
    space: CatchingSpace = field(default_factory=CatchingSpace)
    needs_grip: bool = False

    @property
    def catch(self) -> CatchRules:
        """When a ball counts as caught."""
        return CatchRules(needs_grip=self.needs_grip)


@dataclass
class Session:
    """The session of a plan."""

    plan: SessionPlan
    exercise: Exercise
    juggling: Juggling | None
    id: str = field(default_factory=lambda: str(uuid4()))
    started_at: datetime = field(default_factory=lambda: datetime.now(UTC))
    walk: WalkFigures = field(default_factory=WalkFigures)
    last_com: tuple[float, float, float] | None = None
    is_closed: bool = False
    """Whether its end is in the database."""

    @property
    def is_ended(self) -> bool:
        """Whether it has ended."""
        return self.exercise.state is State.ENDED

    def view(self) -> dict[str, Any]:
        """Return it as the live document shows it; it names nobody."""
        exercise, now_s = self.exercise, time.monotonic()
        return {
            "id": self.id,
            "application": self.plan.application,
            "state": exercise.state.value,
            "goal": {name: value for name, value in asdict(self.plan.goal).items() if value is not None},
            "progress": round(exercise.progress(now_s), 3),
            "exercisedS": round(exercise.exercised_s(now_s), 1),
            "score": exercise.score,
            "throws": len(exercise.throws),
            "caught": exercise.caught,
            "level": round(self.juggling.level, 3) if self.juggling else 0.0,
            "distanceM": round(self.walk.distance_m, 2),
            "pauseReason": ", ".join(sorted(exercise.reasons)),
            "endedBy": exercise.ended_by.value if exercise.ended_by else None,
            "catch": self._catch(),
        }

    def _catch(self) -> dict[str, Any] | None:
        """Return the rules that the headset shows: the reach of a palm, and whether it must close."""
        if self.juggling is None:
            return None
        rules = self.plan.catch
        return {
            "radiusM": rules.radius_m,
            "needsGrip": rules.needs_grip,
            "closedGrip": rules.closed_grip,
        }

    def figures(self) -> dict[str, Any]:
        """Return what the database keeps."""
        exercise, now_s = self.exercise, time.monotonic()
        values: dict[str, Any] = {
            "throws": len(exercise.throws),
            "caught": exercise.caught,
            "score": exercise.score,
            "exercised_s": exercise.exercised_s(now_s),
            "level": self.juggling.level if self.juggling else 0.0,
            "distance_m": self.walk.distance_m,
            "report": self.report(),
        }
        if exercise.ended_by is not None:
            values |= {"ended_at": datetime.now(UTC).isoformat(), "ended_by": exercise.ended_by.value}
        return values

    def report(self) -> dict[str, Any]:
        """Return the report; NaN is null in JSON."""
        exercise = self.exercise
        if self.plan.application == "walking":
            walk = self.walk
            return {
                "exercisedS": exercise.exercised_s(time.monotonic()),
                "walkedS": walk.walked_s,
                "distanceM": walk.distance_m,
                "highestForceN": walk.highest_force_n,
                "meanDirectionErrorRad": walk.mean_direction_error_rad,
            }
        made = juggling_report(exercise, time.monotonic())
        return {
            **_camel(asdict(made)),
            "shareCaught": made.share_caught,
            "outcomes": [
                {"atS": throw.at_s, "level": throw.level, **_camel(asdict(throw.outcome))}
                for throw in exercise.throws
            ],
        }


class Training:
    """Runs one session at a time. Not thread-safe, but for the store."""

    def __init__(self, control: HumanoidControl, store: SessionStore, signals: PatientSignals) -> None:
        self.current: Session | None = None
        self.on_change: Callable[[], None] = lambda: None
        self._control, self._store, self._signals = control, store, signals

    @property
    def store(self) -> SessionStore:
        """The sessions that are kept."""
        return self._store

    def open(self, plan: SessionPlan) -> Session:
        """Begin a session; the caller adds it to the store. Raises `Problem` 409."""
        control = self._control
        if self.current is not None and not self.current.is_ended:
            raise Problem.translated(
                409,
                "Session runs",
                "humanoid.session_runs",
                "a session runs already; end it before another one starts",
            )
        control.motion.require_free()
        wanted = BEHAVIOURS[plan.application]
        if control.motion.behaviour is Behaviour(NAMES[wanted]):
            control.motion.begin(control.motion.behaviour)  # as in the session before
        else:
            control.choose(wanted)
        juggling = None
        if plan.application == "juggling":
            difficulty = Difficulty(plan.space, plan.rules, seed=time.monotonic_ns() % 2**32)
            juggling = Juggling(difficulty, plan.catch, self._on_catch)
        exercise = Exercise(plan.application, plan.goal, time.monotonic())
        self.current = Session(plan, exercise, juggling)
        log.info("session begins", session=self.current.id, application=plan.application)
        return self.current

    def row(self, session: Session) -> dict[str, Any]:
        """Return a new session as the database keeps it."""
        plan = session.plan
        return {
            "id": session.id,
            "humanoid": self._control.name,
            "person": plan.person,
            "application": plan.application,
            "goal": asdict(plan.goal),
            "task": plan.task,
            "started_at": session.started_at.isoformat(),
            **session.figures(),
        }

    def tick(self) -> None:
        """Advance the session by the newest state of the robot."""
        session, control = self.current, self._control
        if session is not None and not session.is_ended:
            self._check_causes(session)
            if session.exercise.state is not State.ENDED:
                self._exercise(session)
            control.motion.is_paused = session.exercise.state is not State.RUNNING
            if session.is_ended:
                control.motion.is_finishing = True
                log.info("session ends", session=session.id, by=session.exercise.ended_by)
        if control.motion.is_finishing:
            self._finish()
        control.live.shown.session = None if session is None else session.view()
        juggling = None if session is None else session.juggling
        is_last = juggling is not None and juggling.number == control.motion.throw.number
        control.live.shown.ball_phase = juggling.shown_phase if juggling is not None and is_last else None

    def pause(self) -> None:
        """Pause by a person's wish."""
        if self.current is not None:
            self.current.exercise.pause(PauseReason.PERSON, time.monotonic())

    def resume(self) -> None:
        """Continue by a person's wish. Raises `SessionError` while a cause of the pause is still there."""
        if self.current is not None:
            self.current.exercise.resume(time.monotonic())

    def end(self, reason: EndReason) -> None:
        """End the session; the robot finishes its step and stands."""
        if self.current is not None and not self.current.is_ended:
            self.current.exercise.end(reason, time.monotonic())
            self._control.motion.is_finishing = True

    def _check_causes(self, session: Session) -> None:
        control, exercise, now_s = self._control, session.exercise, time.monotonic()
        inputs, pose = control.inputs, control.inputs.pose
        is_new = now_s - exercise.started_s < GRACE_S and inputs.is_silent(exercise.started_s)
        is_silent, problem = inputs.is_silent(now_s), inputs.problem(now_s)
        sent = None if is_silent else pose
        is_lost = problem == "jump" or (sent is not None and sent.tracking == "lost")
        is_outside = problem == "far" or (sent is not None and not sent.in_bounds)
        causes = {
            PauseReason.SILENT: is_silent and not is_new,
            PauseReason.TRACKING_LOST: is_lost,
            PauseReason.OUT_OF_BOUNDS: is_outside,
            PauseReason.FORCE: problem == "force",
            PauseReason.STOPPED: control.motion.stopped is not None or control.problem is not None,
        }
        for reason, is_there in causes.items():
            if is_there:
                exercise.pause(reason, now_s)
            else:
                exercise.clear(reason)
        if control.motion.limit.fraction <= 0:
            exercise.end(EndReason.LIMIT, now_s)
        elif control.links.values.get("mode") in {_DOWN, _HOLDING} or control.process.problem:
            exercise.end(EndReason.FAULT, now_s)

    def _exercise(self, session: Session) -> None:
        exercise, now_s, control = session.exercise, time.monotonic(), self._control
        values = control.links.values
        if session.juggling is not None:
            session.juggling.tick(control, exercise, now_s)
        elif exercise.state is State.RUNNING and control.motion.behaviour is Behaviour.ASSISTED_WALKING:
            _walk(session, values)
        if exercise.state is State.RUNNING:
            exercise.check(now_s)

    def _finish(self) -> None:
        """Let the robot stand, then walk by wishes again."""
        motion = self._control.motion
        motion.is_paused = True
        if self._control.is_standing and self._control.links.is_live:
            motion.begin(Behaviour.WALKING)

    def _on_catch(self, side: Side) -> None:
        self._signals.send({"kind": "haptic", "hand": side, "intensity": 0.8, "ms": 60})


def _walk(session: Session, values: Mapping[str, float]) -> None:
    t, x, y = (values.get(name, np.nan) for name in ("robot_time_s", "com.x", "com.y"))
    before, session.last_com = session.last_com, (t, x, y)
    if before is None or not t > before[0]:
        return
    dt_s = t - before[0]
    velocity = np.array([(x - before[1]) / dt_s, (y - before[2]) / dt_s])
    wish = np.array([values.get(f"velocity_reference.{axis}", np.nan) for axis in "xy"])
    forces = [
        float(np.linalg.norm([values.get(f"{side}_hand.force.{axis}", 0.0) for axis in "xyz"]))
        for side in ("left", "right")
    ]
    feet = np.array([values.get(f"feet.{axis}", np.nan) for axis in "xy"])
    session.walk.update(t, feet, wish, velocity, max(forces))


def _camel(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        _name(name): _camel(value) if isinstance(value, dict) else value for name, value in values.items()
    }


def _name(name: str) -> str:
    first, *rest = name.split("_")
    return first + "".join(part.capitalize() for part in rest)
