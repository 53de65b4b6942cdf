"""The reader of one hand: passes frames through the pipeline and keeps its state."""

from dataclasses import replace

from handover.telemetry import get_logger
from handover_gloves.recognition.drift import Drift
from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.gestures import Gestures
from handover_gloves.recognition.pipeline import PipelineState, RecognitionConfig, process_frame
from handover_gloves.recognition.registry import THRESHOLDS

log = get_logger(__name__)


class HandReader:
    """The configuration, the pipeline state and the last raw values of one hand.

    A recognizer that raises is replaced by the threshold recognizer until the next `configure`.
    """

    def __init__(self, glove: str, config: RecognitionConfig) -> None:
        self.config = config
        self.state = PipelineState()
        self.bend: list[float] | None = None
        self._glove = glove

    def read(self, frame: Frame) -> None:
        """Update the state with `frame`."""
        self.bend = frame.bend
        try:
            self.state = process_frame(self.state, frame, self.config)
        except Exception as error:
            if self.config.recognizer_name == THRESHOLDS:
                raise
            # A recognizer of another package may fail in any way; the glove must stay usable.
            log.exception("recognizer failed; falling back to thresholds", glove=self._glove)
            failure = f"it failed with {type(error).__name__}: {error}"
            self.configure(replace(self.config, failure=failure))
            self.state = process_frame(self.state, frame, self.config)

    def configure(self, config: RecognitionConfig) -> None:
        """Use `config` from now on; recognition, drift and hold start again."""
        self.config = config
        self.state = replace(self.state, recognition=None, drift=Drift(), hold=self.state.hold.restarted())

    def set_gestures(self, gestures: Gestures, in_use: frozenset[str]) -> None:
        """Recognize `gestures` from now on; drift and hold continue."""
        if gestures != self.config.gestures or in_use != self.config.in_use:
            self.config = replace(self.config, gestures=gestures, in_use=in_use)
            self.state = replace(self.state, recognition=None)

    def restart_hold(self) -> None:
        """Count the hold from the next frame on."""
        self.state = replace(self.state, hold=self.state.hold.restarted())

    def mark_hold_spent(self) -> None:
        """Mark the hold as counted; the hand must leave the gesture before it counts again."""
        self.state = replace(self.state, hold=self.state.hold.mark_spent())
