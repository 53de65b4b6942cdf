"""A glove: what its hand shows, what is asked of it, and what a gesture held in it means now.

No network and no broker here: frames and errands come in with the time, what happens goes out to the
`Listener` that the glove was given.
"""

import asyncio
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from datamodels.states import Outcome
from handover.job import RequestedAction
from handover.telemetry import get_logger
from services.gesture_controller import metrics
from services.gesture_controller.admission import NotAdmitted
from services.gesture_controller.calibration.drift import Drift
from services.gesture_controller.composed import interplay
from services.gesture_controller.errand import Answer, CannotComplete, Errand, completable
from services.gesture_controller.frames import Frame, Hello
from services.gesture_controller.gestures import Commands, Gestures, Part, codes_in_use
from services.gesture_controller.hold import HoldEvent
from services.gesture_controller.listener import Link, Listener
from services.gesture_controller.pipeline import Rules, Senses, Sight, Verdict, judge, see
from services.gesture_controller.recognition.registry import THRESHOLDS
from services.gesture_controller.thresholds import Thresholds

log = get_logger(__name__)

ON_SCREEN = "paused on the screen"
TAKEOVER_AFTER_S = 3.0
"""A connection that has been silent for so long gives way to a new one of the same glove."""


class Glove:
    """One glove; all moments `now_s` are on the event loop's clock."""

    def __init__(
        self,
        name: str,
        *,
        hand: str,
        person: str | None,
        senses: Senses,
        commands: Commands,
        filtering: bool,
        listener: Listener,
    ) -> None:
        self.name = name
        self.hand = hand
        self.person = person
        self.senses = senses
        self.commands = commands
        self.filtering = filtering
        self.testing = False
        self.paused = False
        self.errand: Errand | None = None
        self.partner: Glove | None = None
        """The other hand's glove, while both answer one errand."""
        self.other_hand: Callable[[], Glove | None] = lambda: None
        """Finds the glove on the other hand of who wears this one."""
        self.free = asyncio.Event()
        self.free.set()
        self.link: Link | None = None
        self.hello = Hello(name, hand)
        self.lost = False
        """True from going silent in the middle of a Task until the next frame."""
        self.sight = Sight()
        self.bend: list[float] | None = None
        self.battery: float | None = None
        self.command: tuple[int, datetime] | None = None
        """The last command given with this glove, and when."""
        self.last_answer: tuple[Answer, float] | None = None
        """How the last errand was answered, and when."""
        self.frames = 0
        self.dropped: Counter[str] = Counter()
        self.rate_hz = 0.0
        self.examination: Callable[[], dict[str, Any]] | None = None
        """What the screen shows of the accuracy test that is being done with it, if one is."""
        self.guidance: Callable[[], dict[str, Any]] | None = None
        """What the screen shows of the calibration that is being done with it, or was at last."""
        self.watchers: set[Callable[[bool], None]] = set()
        """Called when something to be seen has changed, with every frame too; must be quick.

        True when it is more than a movement of the hand, and should be seen at once.
        """
        self.recorders: set[Callable[[bytes], None]] = set()
        """Called with the raw line of every frame."""
        self.interplay = interplay.Interplay()
        self.forgotten = asyncio.Event()
        """Set when the glove is not known any more, and screens stop to follow it."""
        self._silent = f"{name} silent"
        self._listener = listener
        self.last_s = float("-inf")
        """When it was last heard of."""
        self._present = False
        self._met = False
        """True once the glove has been there during the errand: only then can it go missing."""
        self._seen_before = False
        self._rate_from = (0.0, 0)

    # The glove on the line

    @property
    def connected(self) -> bool:
        """Say whether the glove is on the line and has been heard of lately."""
        return self.link is not None and self._present

    def connect(self, link: Link, hello: Hello, now_s: float) -> None:
        """Take `link` for the glove's connection; raise `NotAdmitted` while another one is in use.

        One that has been silent for `TAKEOVER_AFTER_S` is ended: the network may have lost it.
        """
        if self.link is not None and self.link is not link:
            if now_s - self.last_s < TAKEOVER_AFTER_S:
                raise NotAdmitted(
                    "in use",
                    f"another connection of {self.name} is in use; end it, or connect again when it has been "
                    f"silent for {TAKEOVER_AFTER_S:g} s, or give this glove another name",
                    retry=True,
                )
            self.link.end(f"{self.name} has connected again, since this connection was silent")
        self.link, self.hello, self.hand = link, hello, hello.hand
        self.last_s = now_s
        self._present = True
        self._begin_anew()
        self._met = self.errand is not None
        self._changed()

    def disconnect(self, link: Link) -> None:
        """Take notice that `link` has ended."""
        if self.link is link:
            self.link = None
            self._changed()

    def take(self, frame: Frame, line: bytes, now_s: float) -> None:
        """Take a frame, and its raw `line`, that arrived at `now_s`."""
        self.frames += 1
        self.last_s = now_s
        self.bend = frame.bend
        if not self._present or self.lost or not self._seen_before:
            self._heard_again()
        if frame.battery is not None and frame.battery != self.battery:
            self.battery = frame.battery
            self._changed()
        fitted = self.sight.drift.wants_calibration is None
        self.sight = self._see(frame)
        if fitted and (why := self.sight.drift.wants_calibration) is not None:
            self._listener.fits_badly(self, why)
            self._changed()
        self._read(now_s)
        for glove in self._both():  # the other hand's screen follows both
            for watcher in glove.watchers:
                watcher(False)
        for record in self.recorders:
            record(line)

    def _see(self, frame: Frame) -> Sight:
        try:
            return see(self.sight, frame, self.senses)
        except Exception as error:
            if self.senses.recognizer == THRESHOLDS:
                raise
            # a recognizer may be a stranger's, and whatever befalls it must not take the glove away
            log.exception("recognizer failed; thresholds take over", glove=self.name)
            failure = f"it failed with {type(error).__name__}: {error}"
            self.sense_with(replace(self.senses, failure=failure))
            return see(self.sight, frame, self.senses)

    def drop(self, reason: str) -> None:
        """Count a line that was no frame."""
        self.dropped[reason] += 1
        metrics.DROPPED.labels(reason).inc()

    def look_after(self, now_s: float, silence_s: float) -> None:
        """Notice silence, and measure the rate; to be called a few times a second."""
        since_s, before = self._rate_from
        if now_s - since_s >= 1.0:
            self.rate_hz = round((self.frames - before) / (now_s - since_s), 1) if before or since_s else 0.0
            self._rate_from = (now_s, self.frames)
        if now_s - self.last_s < silence_s:
            return
        if self._present:
            self._present = False
            self.rate_hz = 0.0
            self._changed()
        if self.errand is not None and self._met and not self.lost:
            self.lost = True
            metrics.SILENCES.inc()
            self.errand.job.pause(self._silent)
            self._listener.went_silent(self)
            self._changed()

    def _heard_again(self) -> None:
        self._present = True
        if self.errand is not None:
            self._met = True
            self._go_on(self.errand, self._silent)
        if self.lost or not self._seen_before:
            self.lost, self._seen_before = False, True
            self._listener.came_back(self)
        self._changed()

    # What is asked of it

    def begin(self, errand: Errand) -> None:
        """Take an errand; nothing answers it before `listen`."""
        self.errand = errand
        errand.progress = interplay.fresh(errand)
        self.free.clear()
        self._met = self.connected
        if self.paused:
            errand.job.pause(ON_SCREEN)
        self._changed()

    def join(self, partner: "Glove") -> None:
        """Let `partner`, the glove of the other hand, answer the errand together with this one."""
        if self.errand is not None and self.partner is None:
            self.partner, partner.partner = partner, self
            partner.begin(self.errand)
            partner._begin_anew()

    def listen(self) -> None:
        """Let gestures answer the errand from now on: no hold that began before counts."""
        if self.errand is not None and not self.errand.listening:
            self.errand.listening = True
            for glove in self._both():
                glove._begin_anew()

    def rest(self) -> None:
        """Let no gesture answer until `listen`."""
        if self.errand is not None:
            self.errand.listening = False

    def end(self) -> None:
        """Let go of the errand, answered or not."""
        for glove in self._both():
            glove.errand = glove.partner = None
            glove.free.set()
            glove._changed()

    def complete_on_screen(
        self,
        operator: str,
        now_s: float,
        task: str | None = None,
        outcome: Outcome = Outcome.OK,
        note: str | None = None,
    ) -> None:
        """Answer the errand for `operator`, who pressed the button; raises `CannotComplete`.

        `task` is the id of the Task that the button belonged to: a press that comes when another is asked
        for, because somebody else or the hand was quicker, must not answer that one.
        """
        errand = completable(self.errand, self.name, task, testing=self.testing)
        for glove in self._both():
            errand.job.resume(glove._silent)
        if errand.job.requested_action is not RequestedAction.RUN:
            for glove in self._both():
                if glove.lost:
                    errand.job.pause(glove._silent)
            raise CannotComplete(f"the Task of {self.name} is paused; resume it, then complete it")
        self._answer(errand, Answer(errand.asked, 0, "screen", operator, outcome, note), now_s)

    def pause(self) -> None:
        """Let nothing count, and hold the Task, until `resume`."""
        self.paused = True
        if self.errand is not None:
            self.errand.job.pause(ON_SCREEN)
        self._changed()

    def resume(self) -> None:
        """Take `pause` back."""
        self.paused = False
        if self.errand is not None and not any(glove.paused for glove in self._both()):
            self._go_on(self.errand, ON_SCREEN)
        self._begin_anew()
        self._changed()

    def switch(self, *, testing: bool | None, filtering: bool | None) -> None:
        """Switch modes; None leaves one as it is."""
        self.testing = self.testing if testing is None else testing
        self.filtering = self.filtering if filtering is None else filtering
        self._begin_anew()
        self._changed()

    def read_with(self, thresholds: Thresholds) -> None:
        """Read the hand with other thresholds from now on."""
        self.sense_with(replace(self.senses, thresholds=thresholds))

    def sense_with(self, senses: Senses) -> None:
        """Read the hand with other `senses` from now on; what was seen and had drifted is forgotten."""
        self.senses = senses
        self.sight = replace(self.sight, recognition=None, drift=Drift(), hold=self.sight.hold.anew())
        self._changed()

    def equip(self, gestures: Gestures, commands: Commands) -> None:
        """Know these gestures and commands from now on; a hold goes on if its gesture is among them."""
        kept = self.senses.gestures.codes.get(self.sight.gesture or "")
        asked = self.errand.asked.all_parts if self.errand is not None else ()
        in_use = codes_in_use(gestures, commands, asked)
        if gestures != self.senses.gestures or in_use != self.senses.in_use:
            self.senses = replace(self.senses, gestures=gestures, in_use=in_use)
            self.sight = replace(self.sight, recognition=None)
        self.commands = commands
        if kept != gestures.codes.get(self.sight.gesture or ""):
            self._begin_anew()
        self._changed()

    def _go_on(self, errand: Errand, held_for: str) -> None:
        held = errand.job.requested_action is RequestedAction.PAUSE
        errand.job.resume(held_for)
        if held and errand.job.requested_action is RequestedAction.RUN:
            self.listen()  # the hand need not wait until the broker knows

    def _begin_anew(self) -> None:
        self.sight = replace(self.sight, hold=self.sight.hold.anew())
        self.interplay.clear()
        if self.errand is not None:
            self.errand.progress = interplay.fresh(self.errand)

    def _both(self) -> "tuple[Glove, ...]":
        """Return this glove, and the one that answers the errand together with it."""
        return (self,) if self.partner is None else (self, self.partner)

    @property
    def due(self) -> Part | None:
        """Return what the errand asks this hand to show now."""
        return None if self.errand is None else interplay.due_of(self.errand, self.hand)

    def shows(self, part: Part) -> bool:
        """Say whether this hand, or its partner's, shows `part` now."""
        hands = [glove for glove in self._both() if part.hand in {None, glove.hand}]
        return any(glove.connected and glove.sight.gesture == part.gesture for glove in hands)

    def _is_open(self) -> bool:
        """Say whether anything that this hand shows counts now."""
        counts = not any(glove.testing or glove.paused for glove in self._both())
        return counts and (self.errand is None or self.errand.is_open)

    def _read(self, now_s: float) -> None:
        """Find out what the last frame means."""
        hold, errand = self.sight.hold, self.errand
        if hold.last is not HoldEvent.NONE:
            due = self.due
            answers = errand.asked.answers if errand is not None else {}
            rules = Rules(
                due.gesture if due else None, self.commands, self.filtering, self._is_open(), answers
            )
            self._act_on(judge(hold, rules), now_s)
        if self.filtering and (errand is None or errand.asked.composed is None):
            return
        if self._is_open():
            self._read_composed(errand, now_s)
        elif errand is not None:
            errand.progress = interplay.fresh(errand)

    def _read_composed(self, errand: Errand | None, now_s: float) -> None:
        held_ms = None if errand is None else interplay.answered(errand, self, self.partner, now_s)
        if errand is not None and held_ms is not None and not errand.answer.done():
            self._spend()
            self._answer(errand, Answer(errand.asked, held_ms, "gesture"), now_s)
        if self.filtering:
            return
        command = self.interplay.commanded(self, errand.asked.gesture if errand else None, now_s)
        if command is not None:
            metrics.COMMANDS.inc()
            for glove in command.hands:
                glove._spend()
                glove._give(self.commands.ids[command.gesture])

    def _spend(self) -> None:
        for glove in self._both():
            glove.sight = replace(glove.sight, hold=glove.sight.hold.spend())

    def _act_on(self, verdict: Verdict, now_s: float) -> None:
        hold, errand = self.sight.hold, self.errand
        if verdict is Verdict.WRONG:
            metrics.WRONG_GESTURES.inc()
        elif verdict is Verdict.COMPLETE and errand is not None:
            outcome = errand.asked.outcome_of(hold.gesture) or Outcome.OK
            if (
                outcome is not Outcome.OK or errand.asked.composed is None
            ):  # else a part counts with the other
                self._spend()
                answer = Answer(errand.asked, hold.held_ms, "gesture", outcome=outcome)
                self._answer(errand, answer, now_s)
        elif (
            verdict is Verdict.COMMAND
            and hold.gesture is not None
            and not interplay.is_part_of_more(hold.gesture, self, errand)
        ):
            self._spend()
            metrics.COMMANDS.inc()
            self._give(self.commands.ids[hold.gesture])

    def _answer(self, errand: Errand, answer: Answer, now_s: float) -> None:
        errand.answer.set_result(answer)
        metrics.CONFIRMATIONS.labels(answer.by, answer.outcome.value).inc()
        for glove in self._both():
            glove.last_answer = (answer, now_s)
            if answer.command_id is None:
                glove._changed()
            else:
                glove._give(answer.command_id)

    def _give(self, command_id: int) -> None:
        self.command = (command_id, datetime.now(UTC))
        self._changed()

    # What is to be seen of it

    @property
    def device_state(self) -> str:
        """Return the `deviceState` of its Device entity."""
        if self.lost:
            return "error"
        if self.paused or (
            self.errand is not None and self.errand.job.requested_action is RequestedAction.PAUSE
        ):
            return "paused"
        if self.errand is not None:
            return "busy"
        return "ok" if self.connected else "idle"

    def _changed(self) -> None:
        self._listener.state_changed(self)
        for watcher in self.watchers:
            watcher(True)
