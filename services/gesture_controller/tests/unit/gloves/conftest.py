"""Two gloves of one person, without network."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from handover_gloves.configuration.gestures_file import parse
from handover_gloves.gloves.glove import Glove
from handover_gloves.recognition.frames import Frame, Hello
from handover_gloves.recognition.hold import HoldTiming
from handover_gloves.recognition.pipeline import RecognitionConfig
from handover_gloves.recognition.thresholds import Threshold, Thresholds

SITE = parse(
    """
gestures:
  Thumbs up: 02222
  Horns: 20220
  Point with index: 20222
  Both thumbs up: {left: 02222, right: 02222}
  Cross: {left: Horns, right: 22222}
  Wave off: {sequence: [Point with index, Horns]}
commands: {1: Thumbs up, 2: Horns, 3: Both thumbs up, 4: Wave off, 5: Cross}
"""
)


@dataclass
class Pair:
    """A left and a right hand; the gloves' clocks have nothing to do with each other."""

    left: Glove
    right: Glove
    now_s: float = 1000.0

    def show(self, left: str | None, right: str | None, seconds: float) -> None:
        """Make finger states with both hands; None: that glove is silent."""
        for _ in range(round(seconds * 50)):
            self.now_s += 0.02
            for glove, code, ahead_s in ((self.left, left, 7.0), (self.right, right, 500.0)):
                if code is not None:
                    bend = [700.0 if state == "0" else 300.0 for state in code]
                    glove.receive(Frame(round(self.now_s + ahead_s, 3), bend), b"", self.now_s)
                glove.check_silence(self.now_s, silence_s=2.0)


@pytest.fixture
def pair(listener_log: Any, link: Callable[[], Any]) -> Pair:
    """Both hands in gloves, connected."""
    thresholds = Thresholds((Threshold(600, 400),) * 5)
    gloves = [
        Glove(
            f"{hand}-1",
            hand=hand,
            person="anna",
            config=RecognitionConfig(thresholds, SITE.gestures, HoldTiming()),
            commands=SITE.commands,
            filtering=True,
            listener=listener_log,
        )
        for hand in ("left", "right")
    ]
    left, right = gloves
    left.responder.other_hand = lambda: right.responder
    right.responder.other_hand = lambda: left.responder
    for glove in gloves:
        glove.connect(link(), Hello(glove.name, glove.hand), 1000.0)
    return Pair(left, right)
