"""What a person or a headset does wrong pauses the session, stops the robot, and is named."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from handover.control.limit_link import LimitLink
from handover.database import connect
from handover.errors import Problem
from handover_humanoid.behaviours.component_state import Behaviour
from handover_humanoid.running.humanoid_control import HumanoidControl
from handover_humanoid.running.inputs import SILENT_S, PoseMessage, PullMessage
from handover_humanoid.running.sessions.signals import PatientSignals
from handover_humanoid.running.sessions.store import SessionStore
from handover_humanoid.running.sessions.training import GRACE_S, Session, SessionPlan, Training
from handover_humanoid.running.store import Store
from handover_humanoid.sessions.exercise import (
    CAUSES,
    EndReason,
    Goal,
    PauseReason,
    SessionError,
    State,
)
from handover_humanoid.sessions.plausible import RELEASE_S
from handover_humanoid.settings import WholeBodySettings

HAND = (0.5, -0.1, 0.6)
CLOCK = "handover_humanoid.running.inputs.time.monotonic"


class Exercises:
    """A session of walking beside a control cycle that stands, on a clock of the test."""

    def __init__(self, control: HumanoidControl, training: Training) -> None:
        self.control, self.now_s = control, 1000.0
        control.process.problem, control.links.age_s = "", 0.0
        control.links.values = {"phase": 0.0, "mode": 0.0, "behaviour": 0.0}
        self._training = training

    def begin(self) -> Session:
        session = self._training.open(SessionPlan("walking", Goal(seconds=600)))
        self.send()
        self.later(GRACE_S)
        return session

    def send(self, hand: tuple[float, float, float] = HAND, **more: Any) -> None:
        pose = {"kind": "pose", "t": 1.0, "hands": {"left": {"position": hand, "grip": 1.0}}, **more}
        self.control.inputs.receive(PoseMessage.model_validate(pose))

    def pull(self, force_n: float) -> None:
        self.control.inputs.receive(PullMessage(kind="pull", left=(force_n, 0.0, 0.0)))

    def later(self, seconds: float, *, is_sending: bool = True) -> None:
        """Let time pass, in which the same pose arrives again and again."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s += 0.1
            if is_sending:
                self.send()
            self._training.tick()

    def wish(self) -> dict[str, float]:
        """Return what the control cycle is sent."""
        names = ("stop", "cancel", "speed_share")
        return dict(zip(names, self.control.motion.values(names), strict=True))

    def pause(self) -> None:
        self._training.pause()
        self._training.tick()

    def end(self, *, is_standing: bool) -> None:
        self.control.links.values = {**self.control.links.values, "phase": 0.0 if is_standing else 2.0}
        self._training.end(EndReason.PERSON)
        if not is_standing:
            self._training.tick()

    def stand(self) -> None:
        self.control.links.values = {**self.control.links.values, "phase": 0.0}

    def resume(self) -> None:
        self._training.resume()
        self._training.tick()


@pytest.fixture
def exercises(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Exercises]:
    settings = WholeBodySettings.load(data_dir=tmp_path, humanoid_ports_dir=tmp_path / "ports")
    engine = connect(settings.database("whole-body-control"))
    limits = LimitLink("http://127.0.0.1:1", "coman-1", headers=dict)
    control = HumanoidControl(settings, Store(engine), limits)
    made = Exercises(control, Training(control, SessionStore(engine), PatientSignals()))
    monkeypatch.setattr(CLOCK, lambda: made.now_s)
    yield made
    control.throws.close()
    engine.dispose()


@pytest.mark.parametrize(
    ("act", "reason"),
    [
        (lambda patient: patient.send(tracking="lost"), "trackingLost"),
        (lambda patient: patient.send(inBounds=False), "outOfBounds"),
        (lambda patient: patient.send((0.9, 0.6, 0.6)), "trackingLost"),
        (lambda patient: patient.send((9.0, 0.0, 0.6)), "outOfBounds"),
        (lambda patient: patient.pull(200.0), "force"),
        (lambda patient: patient.later(SILENT_S, is_sending=False), "silent"),
    ],
    ids=[
        "lost tracking",
        "out of bounds",
        "a hand that jumps",
        "a hand in another room",
        "a fall",
        "silence",
    ],
)
def test_the_robot_stands_and_the_session_names_the_cause_until_a_person_resumes_it(
    exercises: Exercises, act: Callable[[Exercises], None], reason: str
) -> None:
    session = exercises.begin()
    assert (session.exercise.state, exercises.wish()["stop"]) == (State.RUNNING, 0.0)
    act(exercises)
    exercises.later(0.1, is_sending=False)
    assert reason in session.view()["pauseReason"]
    assert exercises.wish()["stop"] == 1.0
    with pytest.raises(SessionError, match=CAUSES[PauseReason(reason)]):
        exercises.resume()
    exercises.later(2 * RELEASE_S)  # what arrives is plausible again
    assert (session.view()["state"], session.view()["pauseReason"]) == ("paused", "")
    assert exercises.wish()["stop"] == 1.0
    exercises.resume()
    assert (session.exercise.state, exercises.wish()["stop"]) == (State.RUNNING, 0.0)


def test_a_choice_after_a_session_is_not_undone_when_its_robot_stands(exercises: Exercises) -> None:
    exercises.begin()
    exercises.end(is_standing=True)
    exercises.control.choose("assistedWalking")  # as in the session, and before it is noticed that it stands
    exercises.later(0.2)
    assert exercises.control.motion.behaviour is Behaviour.ASSISTED_WALKING
    assert exercises.wish()["stop"] == 0.0

    exercises.begin()
    exercises.end(is_standing=False)
    with pytest.raises(Problem, match="let it stand first"):
        exercises.control.choose("assistedWalking")
    assert exercises.wish()["stop"] == 1.0
    exercises.stand()
    exercises.later(0.2)
    assert exercises.control.motion.behaviour is Behaviour.WALKING


def test_a_choice_does_not_resume_a_paused_session(exercises: Exercises) -> None:
    exercises.begin()
    exercises.pause()
    exercises.control.choose("walking")
    assert exercises.wish()["stop"] == 1.0
