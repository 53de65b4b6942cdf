"""A glove without network: hands that show gestures, Tasks that wait, and a listener_log of what happened."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import uvloop
from sqlalchemy import Engine

from handover.broker import BrokerClient
from handover.database import connect
from handover.job import Job
from handover.tasks.finished_tasks import FinishedTasks
from handover_datamodels.entities import Task
from handover_datamodels.states import Outcome
from handover_gloves.configuration.gestures_file import built_in
from handover_gloves.gloves.glove import Glove
from handover_gloves.prompting.prompt import GesturePrompt, PromptSpec
from handover_gloves.recognition.frames import Frame, Hello
from handover_gloves.recognition.gestures import M2O2P_GESTURES, Part
from handover_gloves.recognition.hold import HoldTiming
from handover_gloves.recognition.pipeline import RecognitionConfig
from handover_gloves.recognition.thresholds import Threshold, Thresholds
from handover_gloves.settings import ControllerSettings

SAME = Thresholds((Threshold(600, 400),) * 5)


@dataclass
class ListenerLog:
    """Records the events of gloves."""

    states: list[str] = field(default_factory=list)
    silent: list[str] = field(default_factory=list)
    back: list[str] = field(default_factory=list)
    needing_calibration: list[str] = field(default_factory=list)
    restored: list[str] = field(default_factory=list)

    def state_changed(self, glove: Glove) -> None:
        if not self.states or self.states[-1] != glove.device_state:
            self.states.append(glove.device_state)

    def went_silent(self, glove: Glove) -> None:
        self.silent.append(glove.name)

    def came_back(self, glove: Glove) -> None:
        self.back.append(glove.name)

    def needs_calibration(self, glove: Glove, reason: str) -> None:
        self.needing_calibration.append(reason)

    def calibration_restored(self, glove: Glove) -> None:
        self.restored.append(glove.name)


@dataclass
class Wire:
    """The connection of a glove, as the glove sees it."""

    ended: list[str] = field(default_factory=list)

    def end(self, reason: str) -> None:
        self.ended.append(reason)


@dataclass
class Hand:
    """Wears the glove: `now_s` is the time here, the glove's own clock is `ahead_s` ahead of it."""

    glove: Glove
    wire: Wire
    now_s: float = 1000.0
    ahead_s: float = 50.0

    def show(self, gesture: str | None, seconds: float, hz: float = 50) -> None:
        """Hold a gesture (None: an open hand) for a while."""
        code = M2O2P_GESTURES[gesture] if gesture else "00000"
        self.make(code, seconds, hz)

    def make(self, code: str, seconds: float, hz: float = 50) -> None:
        """Make five finger states for a while."""
        bend = [{"0": 700.0, "1": 500.0, "2": 300.0}[state] for state in code]
        for _ in range(round(seconds * hz)):
            self.now_s += 1 / hz
            self.glove.receive(Frame(self.now_s + self.ahead_s, bend), b"", self.now_s)
            self.glove.check_silence(self.now_s, silence_s=2.0)

    def be_silent(self, seconds: float) -> None:
        """Send nothing for a while."""
        for _ in range(round(seconds * 10)):
            self.now_s += 0.1
            self.glove.check_silence(self.now_s, silence_s=2.0)


def pytest_asyncio_loop_factories(item: pytest.Item) -> dict[str, Callable[[], Any]]:
    """Try the glove server on both event loops: services run on uvloop where there is one."""
    plain = {"asyncio": asyncio.SelectorEventLoop}
    return {**plain, "uvloop": uvloop.new_event_loop} if item.path.stem == "test_glove_server" else plain


@pytest.fixture
def listener_log() -> ListenerLog:
    """The events of gloves."""
    return ListenerLog()


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Engine]:
    """The database of the controller."""
    engine = connect(f"sqlite:///{tmp_path / 'gesture_controller.db'}")
    yield engine
    engine.dispose()


@pytest.fixture
def glove(listener_log: ListenerLog) -> Glove:
    """A right glove whose fingers are straight above 600 and bent below 400."""
    site = built_in()
    return Glove(
        "glove-1",
        hand="right",
        person=None,
        config=RecognitionConfig(SAME, site.gestures, HoldTiming()),
        commands=site.commands,
        filtering=True,
        listener=listener_log,
    )


@pytest.fixture
def link() -> Callable[[], Wire]:
    """Make connections."""
    return Wire


@pytest.fixture
def hand(glove: Glove) -> Hand:
    """A hand in the glove, which is connected."""
    wire = Wire()
    glove.connect(wire, Hello("glove-1"), 1000.0)
    return Hand(glove, wire)


@pytest.fixture
async def make_job() -> AsyncIterator[Callable[..., Job]]:
    """Make jobs; their broker is never asked."""
    async with BrokerClient(ControllerSettings()) as broker:

        def make(name: str = "t1", **attributes: Any) -> Job:
            task = Task.model_validate(
                {
                    "id": f"urn:ngsi-ld:Task:demo:{name}",
                    "is_defined_by": "urn:ngsi-ld:TaskDefinition:demo:confirm",
                    "status": "inProgress",
                    **attributes,
                }
            )
            return Job(
                task, "urn:ngsi-ld:Device:demo:glove-1", broker, FinishedTasks(ControllerSettings(), "glove")
            )

        yield make


@pytest.fixture
def ask(glove: Glove, make_job: Callable[..., Job]) -> Callable[..., GesturePrompt]:
    """Ask the wearer of the glove for a gesture."""

    def begin(gesture: str, name: str = "t1", answers: Mapping[Outcome, str] | None = None) -> GesturePrompt:
        job = make_job(name)
        others = {outcome: Part(shown, M2O2P_GESTURES[shown]) for outcome, shown in (answers or {}).items()}
        asked = PromptSpec(job.task.id, "Confirm", gesture, M2O2P_GESTURES[gesture], 3, answers=others)
        prompt = GesturePrompt(asked, job, asyncio.get_running_loop().create_future())
        glove.responder.begin(prompt)
        glove.responder.listen()
        return prompt

    return begin
