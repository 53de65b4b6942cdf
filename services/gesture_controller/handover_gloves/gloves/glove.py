"""A glove: its connection, its hand and its prompt.

There is no network and no broker here. Frames and prompts come in with the time; events go out to the
`GloveListener`.
"""

from typing import Protocol

from handover_gloves import metrics
from handover_gloves.gloves.connection_state import ConnectionState, GloveLink
from handover_gloves.gloves.gesture_responder import GestureResponder
from handover_gloves.gloves.glove_observers import GloveObservers
from handover_gloves.prompting.modes import GloveModes
from handover_gloves.recognition.frames import Frame, Hello
from handover_gloves.recognition.gestures import Commands, Gestures, codes_in_use
from handover_gloves.recognition.hand_reader import HandReader
from handover_gloves.recognition.pipeline import RecognitionConfig


class GloveListener(Protocol):
    """Receives the events of gloves."""

    def state_changed(self, glove: "Glove") -> None:
        """Called when the content of the Device entity may have changed."""

    def went_silent(self, glove: "Glove") -> None:
        """Called when the glove stopped sending during a Task."""

    def came_back(self, glove: "Glove") -> None:
        """Called with the first frame, and with the first one after silence."""

    def needs_calibration(self, glove: "Glove", reason: str) -> None:
        """Called when the glove should be calibrated again; `reason` is half a sentence."""

    def calibration_restored(self, glove: "Glove") -> None:
        """Called when the glove has been calibrated, or somebody else wears it."""


class Glove:
    """One glove; all moments `now_s` are on the event loop's clock."""

    def __init__(
        self,
        name: str,
        *,
        hand: str,
        person: str | None,
        config: RecognitionConfig,
        commands: Commands,
        filtering: bool,
        listener: GloveListener,
    ) -> None:
        self.name = name
        self.person = person
        self.connection = ConnectionState(Hello(name, hand))
        self.reader = HandReader(name, config)
        self.modes = GloveModes(filtering)
        self.observers = GloveObservers()
        self.responder = GestureResponder(self.connection, self.reader, self.modes, commands, self._changed)
        self._listener = listener

    @property
    def hand(self) -> str:
        """`left` or `right`."""
        return self.connection.hello.hand

    @property
    def is_connected(self) -> bool:
        """True if the glove has a connection and sent something lately."""
        return self.connection.is_connected

    @property
    def device_state(self) -> str:
        """The `deviceState` of the Device entity."""
        if self.connection.is_lost:
            return "error"
        if self.responder.is_paused:
            return "paused"
        if self.responder.prompt is not None:
            return "busy"
        return "ok" if self.is_connected else "idle"

    def connect(self, link: GloveLink, hello: Hello, now_s: float) -> None:
        """Use `link` from now on; raise `ConnectionRefused` while another connection is in use."""
        self.connection.connect(link, hello, now_s)
        self.responder.restart()
        self.connection.was_present = self.responder.prompt is not None
        self._changed()

    def disconnect(self, link: GloveLink) -> None:
        """Forget `link`, which has ended."""
        if self.connection.disconnect(link):
            self._changed()

    def receive(self, frame: Frame, line: bytes, now_s: float) -> None:
        """Process a frame, and its raw `line`, that arrived at `now_s`."""
        if self.connection.count_frame(now_s):
            self._recover()
        if frame.battery is not None and frame.battery != self.connection.battery:
            self.connection.battery = frame.battery
            self._changed()
        needed_calibration, config = self.reader.state.drift.wants_calibration, self.reader.config
        self.reader.read(frame)
        if self.reader.config is not config:
            self._changed()
        reason = self.reader.state.drift.wants_calibration
        if needed_calibration is None and reason is not None:
            self._listener.needs_calibration(self, reason)
            self._changed()
        self.responder.respond(now_s)
        self.observers.record(line)

    def check_silence(self, now_s: float, silence_s: float) -> None:
        """Detect silence and measure the frame rate; call this a few times a second."""
        connection = self.connection
        connection.traffic.measure_rate(now_s)
        if now_s - connection.last_s < silence_s:
            return
        if connection.is_sending:
            connection.is_sending = False
            connection.traffic.rate_hz = 0.0
            self._changed()
        if self.responder.prompt is not None and connection.was_present and not connection.is_lost:
            connection.is_lost = True
            metrics.GLOVE_SILENCES.inc()
            self.responder.pause_for_silence()
            self._listener.went_silent(self)
            self._changed()

    def pause(self) -> None:
        """Let nothing count, and pause the Task, until `resume`."""
        self.modes.paused = True
        self.responder.pause()
        self._changed()

    def resume(self) -> None:
        """End `pause`."""
        self.modes.paused = False
        self.responder.resume()
        self._changed()

    def switch(self, *, testing: bool | None, filtering: bool | None) -> None:
        """Set modes; None keeps a mode."""
        self.modes.testing = self.modes.testing if testing is None else testing
        self.modes.filtering = self.modes.filtering if filtering is None else filtering
        self.responder.restart()
        self._changed()

    def configure(self, config: RecognitionConfig) -> None:
        """Recognize with `config` from now on; recognition and drift start again."""
        self.reader.configure(config)
        self._changed()

    def equip(self, gestures: Gestures, commands: Commands) -> None:
        """Use these gestures and commands from now on; a hold continues if its gesture is unchanged."""
        shown = self.reader.state.gesture or ""
        before = self.reader.config.gestures.codes.get(shown)
        prompt = self.responder.prompt
        in_use = codes_in_use(gestures, commands, prompt.spec.all_parts if prompt is not None else ())
        self.reader.set_gestures(gestures, in_use)
        self.responder.commands = commands
        if before != gestures.codes.get(shown):
            self.responder.restart()
        self._changed()

    def _recover(self) -> None:
        """Handle the first frame, and the first frame after silence."""
        connection = self.connection
        connection.is_sending = True
        self.responder.resume_after_silence()
        if connection.is_lost or not connection.has_sent:
            connection.is_lost, connection.has_sent = False, True
            self._listener.came_back(self)
        self._changed()

    def _changed(self, *, is_urgent: bool = True) -> None:
        if is_urgent:
            self._listener.state_changed(self)
        self.observers.notify(is_urgent=is_urgent)
