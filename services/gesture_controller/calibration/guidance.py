"""Guidance: calibrations on their way with worn gloves, and what becomes of them.

While a hand is guided its glove is in testing mode: no gesture that is shown then answers a Task. What was
measured is applied at once, or kept as offered until somebody accepts it; both survive a restart. What was
not finished then is told as interrupted: a person who kept still for it has to begin again.
"""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from handover.errors import Problem
from handover.messages import message, text_of
from handover.telemetry import get_logger
from services.gesture_controller.calibration.doubts import Doubt, doubts_about, lasting_doubts
from services.gesture_controller.calibration.fitting import OFFERED, SAMPLES, calibration_from, learnt_from
from services.gesture_controller.calibration.guide import HAND, SAMPLE, Guide, Phase, Step
from services.gesture_controller.calibration.levels import Calibration, CalibrationFailed, calibrate
from services.gesture_controller.calibration.logbook import Logbook
from services.gesture_controller.calibration.samples import sample_of, with_sample
from services.gesture_controller.finger_states import BENT, STRAIGHT
from services.gesture_controller.glove import Glove
from services.gesture_controller.gloves import Gloves
from services.gesture_controller.people.people import on_disk
from services.gesture_controller.recognition.registry import UnknownRecognizer, maker_of
from services.gesture_controller.thresholds import FINGERS, M2O2P_THRESHOLDS
from services.gesture_controller.wording import Message

log = get_logger(__name__)


class Guided:
    """One calibration of one glove: its guide, and its end."""

    def __init__(
        self, glove: Glove, guide: Guide, *, apply: bool, gesture: str | None, code: str | None
    ) -> None:
        self.glove = glove
        self.guide = guide
        self.apply = apply
        self.gesture = gesture
        self.code = code
        self.person = glove.person
        self.tested_before = glove.testing
        self.outcome: dict[str, Any] | None = None
        """What became of it, once it is over: `applied` or `offered`, or the `problem`; and `doubts`."""
        self.watch: Callable[[bool], None] | None = None

    def view(self) -> dict[str, Any]:
        """Return what the screen shows of it."""
        guide = self.guide
        return {
            "step": guide.step.value,
            "steps": [step.value for step in guide.steps],
            "phase": guide.phase.value,
            "gesture": self.gesture,
            "code": self.code or _CODES[guide.step],
            "remainingMs": round(1000 * max(guide.remaining_s, 0.0)),
            "restless": list(guide.restless),
            "message": _message(self).as_dict(),
            "outcome": self.outcome,
        }


class Guidance:
    """All calibrations that are on their way."""

    def __init__(self, gloves: Gloves, logbook: Logbook) -> None:
        self._gloves = gloves
        self._logbook = logbook
        self._guided: dict[str, Guided] = {}
        self._ending: set[asyncio.Task[None]] = set()
        self._writing = asyncio.Lock()
        self._interrupted = logbook.guided()
        """By glove, the gesture that it was being guided to show when the controller stopped."""
        for glove in gloves:
            self._tell_of_interruption(glove)
        gloves.newcomers.append(self._tell_of_interruption)

    async def begin(
        self, glove: Glove, *, gesture: str | None, apply: bool, countdown_s: float
    ) -> dict[str, Any]:
        """Begin to guide the hand in `glove`: fist and open hand, or `gesture`; raises `Problem`.

        One that is on its way begins anew.
        """
        if not glove.connected:
            raise Problem(
                409,
                "Glove away",
                message(
                    "calibration.glove_away",
                    "{glove} is not connected; put it on and switch it on",
                    glove=glove.name,
                ),
            )
        if glove.examination is not None:
            raise Problem(
                409,
                "Test on its way",
                message(
                    "calibration.test_running",
                    "an accuracy test is on its way with {glove}; stop it first",
                    glove=glove.name,
                ),
            )
        code = None
        if gesture is not None:
            code = self._code_of(glove, gesture)
            self._calibration_of(glove)
        self._drop(glove)
        guide = Guide(HAND if gesture is None else SAMPLE, countdown_s)
        guided = Guided(glove, guide, apply=apply, gesture=gesture, code=code)
        glove.switch(testing=True, filtering=None)
        guided.watch = lambda _: self._look(guided)
        glove.watchers.add(guided.watch)
        self._guided[glove.name] = guided
        glove.guidance = guided.view
        async with self._writing:
            await on_disk(lambda: self._logbook.guide_began(glove.name, gesture))
        return guided.view()

    async def stop(self, glove: Glove) -> None:
        """Give up the calibration of `glove`, if there is one; nothing is changed by it."""
        if self._drop(glove):
            async with self._writing:
                if glove.name not in self._guided:
                    await on_disk(lambda: self._logbook.guide_ended(glove.name))

    def view(self, glove: Glove) -> dict[str, Any] | None:
        """Return how far the calibration of `glove` is, or how its last one ended."""
        guided = self._guided.get(glove.name)
        return None if guided is None else guided.view()

    async def accept(self, glove: Glove) -> None:
        """Apply what was measured last and only offered; raise `Problem` 409 if there is nothing."""
        offered = self._gloves.fit_of(glove).learnt.get(OFFERED)
        calibration = None
        if isinstance(offered, dict):
            thresholds = M2O2P_THRESHOLDS.with_changes(offered.get("thresholds", {}))
            calibration = calibration_from(offered, thresholds)
        if calibration is None:
            raise Problem(
                409,
                "Nothing offered",
                message(
                    "calibration.nothing_offered",
                    "no calibration of {glove} waits to be accepted",
                    glove=glove.name,
                ),
            )
        await self._gloves.keep_calibration(glove, calibration)

    async def sample(self, glove: Glove, gesture: str, frames: Sequence[Sequence[float]]) -> Calibration:
        """Take `frames` (five raw values each) for a sample of `gesture` (name or code); raises `Problem`."""
        code, calibration = self._code_of(glove, gesture), self._calibration_of(glove)
        try:
            sampled = with_sample(calibration, sample_of(code, frames, calibration.levels))
        except CalibrationFailed as error:
            raise Problem(422, "Sample failed", text_of(error)) from None
        await self._keep_samples(glove, sampled)
        return sampled

    async def forget_sample(self, glove: Glove, gesture: str) -> None:
        """Forget the sample of `gesture`; raise `Problem` 404 if there is none."""
        code, calibration = self._code_of(glove, gesture), self._calibration_of(glove)
        others = tuple(sample for sample in calibration.samples if sample.code != code)
        if len(others) == len(calibration.samples):
            raise Problem(
                404,
                "No sample",
                message(
                    "calibration.no_sample",
                    'there is no sample of "{gesture}" for {glove}',
                    gesture=gesture,
                    glove=glove.name,
                ),
            )
        await self._keep_samples(glove, replace(calibration, samples=others))

    async def choose(self, glove: Glove, recognizer: str) -> None:
        """Read `glove` with `recognizer` from now on, and keep that; raises `Problem` 422."""
        try:
            maker_of(recognizer)
        except UnknownRecognizer as error:
            raise Problem(422, "Unknown recognizer", text_of(error)) from None
        await self._gloves.keep_fit(glove, replace(self._gloves.fit_of(glove), recognizer=recognizer))
        self._gloves.fit_again(glove)

    def summary(self, glove: Glove) -> dict[str, Any]:
        """Return how `glove` is calibrated for who wears it."""
        senses, fit = glove.senses, self._gloves.fit_of(glove)
        calibration = senses.calibration
        return {
            "recognizer": senses.recognizer,
            "missing": senses.missing,
            "thresholds": senses.thresholds.as_dict(),
            "previous": fit.previous.as_dict() if fit.previous else None,
            "levels": calibration.as_dict() if calibration else None,
            "samples": learnt_from(calibration)[SAMPLES] if calibration else {},
            "doubts": [doubt.as_dict() for doubt in lasting_doubts(calibration)] if calibration else [],
            "offered": OFFERED in fit.learnt,
            "changedAt": fit.changed_at or None,
        }

    def _look(self, guided: Guided) -> None:
        seen = guided.glove.sight.recognition
        if guided.guide.is_over or seen is None or guided.glove.bend is None:
            return
        if seen.at_s == guided.guide.at_s:
            return  # something else than the hand has changed
        guided.guide = guided.guide.after(guided.glove.bend, seen.at_s)
        if guided.guide.is_over:
            ending = asyncio.get_running_loop().create_task(self._end(guided))
            self._ending.add(ending)
            ending.add_done_callback(self._ending.discard)

    async def _end(self, guided: Guided) -> None:
        try:
            guided.outcome = await self._outcome(guided)
        except Problem as problem:
            guided.outcome = {"applied": False, "problem": problem.detail, "doubts": []}
        finally:
            _let_go(guided)
        await self._forget(guided)

    async def _forget(self, guided: Guided) -> None:
        """Have it no longer told as interrupted, unless another has begun with the glove meanwhile."""
        name = guided.glove.name
        async with self._writing:
            if self._guided.get(name) is guided:
                try:
                    await on_disk(lambda: self._logbook.guide_ended(name))
                except Problem as problem:
                    log.warning("the end of a calibration was not kept", glove=name, why=problem.detail)

    def _drop(self, glove: Glove) -> bool:
        """Let go of the calibration of `glove`; say whether there was one."""
        guided = self._guided.pop(glove.name, None)
        glove.guidance = None
        if guided is not None:
            _let_go(guided)
        return guided is not None

    def _tell_of_interruption(self, glove: Glove) -> None:
        if glove.name not in self._interrupted:
            return
        gesture = self._interrupted.pop(glove.name)
        code = None if gesture is None else glove.senses.gestures.codes.get(gesture)
        guide = Guide(HAND if gesture is None else SAMPLE, phase=Phase.INTERRUPTED)
        guided = Guided(glove, guide, apply=False, gesture=gesture, code=code)
        what = "showing the fist and the open hand" if gesture is None else f'showing "{gesture}"'
        guided.outcome = _told(
            False, f"the controller stopped while you were {what}; nothing was changed, begin again", []
        )
        self._guided[glove.name] = guided
        glove.guidance = guided.view

    async def _outcome(self, guided: Guided) -> dict[str, Any]:
        glove, guide = guided.glove, guided.guide
        if guide.phase is Phase.GIVEN_UP:
            raise Problem(
                409,
                "Given up",
                message(
                    "calibration.hand_not_still", "the hand was never still; begin again when you are ready"
                ),
            )
        if glove.person != guided.person:
            raise Problem(
                409,
                "Somebody else",
                message("calibration.wearer_changed", "somebody else wears the glove by now; begin again"),
            )
        if guided.gesture is not None:
            await self.sample(glove, guided.gesture, guide.captured[0])
            return {"applied": True, "problem": None, "doubts": []}
        fist, open_hand = guide.hand()
        doubts = doubts_about(fist, open_hand)
        try:
            calibration = await asyncio.to_thread(calibrate, fist, open_hand)
        except CalibrationFailed as error:
            return _told(False, str(error), doubts)
        if not guided.apply:
            fit = self._gloves.fit_of(glove)
            offered = {"thresholds": calibration.thresholds.as_dict(), **learnt_from(calibration)}
            await self._gloves.keep_fit(glove, replace(fit, learnt={**fit.learnt, OFFERED: offered}))
            return {**_told(False, None, doubts), "offered": offered}
        await self._gloves.keep_calibration(glove, calibration)
        log.info("hand calibrated", glove=glove.name, doubts=len(doubts))
        return _told(True, None, doubts)

    async def _keep_samples(self, glove: Glove, calibration: Calibration) -> None:
        fit = self._gloves.fit_of(glove)
        learnt = {**fit.learnt, SAMPLES: learnt_from(calibration)[SAMPLES]}
        await self._gloves.keep_fit(glove, replace(fit, learnt=learnt))
        self._gloves.fit_again(glove)

    def _code_of(self, glove: Glove, gesture: str) -> str:
        gestures = glove.senses.gestures
        name = gestures.find(gesture) or gestures.names.get(gesture)
        code = gestures.codes.get(name or "")
        if code is None:
            raise Problem(
                422,
                "Unknown gesture",
                message(
                    "calibration.unknown_gesture",
                    'there is no gesture "{gesture}"; {hint}',
                    gesture=gesture,
                    hint=gestures.like(gesture),
                ),
            )
        return code

    def _calibration_of(self, glove: Glove) -> Calibration:
        calibration = glove.senses.calibration
        if calibration is None:
            raise Problem(
                409,
                "Not calibrated",
                message(
                    "calibration.not_calibrated",
                    "{glove} knows no fist and open hand of {person} yet; calibrate it with them first",
                    glove=glove.name,
                    person=glove.person or "who wears it",
                ),
            )
        return calibration


def _told(applied: bool, problem: str | None, doubts: Sequence[Doubt]) -> dict[str, Any]:
    return {"applied": applied, "problem": problem, "doubts": [doubt.as_dict() for doubt in doubts]}


def _let_go(guided: Guided) -> None:
    if guided.watch is not None:
        guided.glove.watchers.discard(guided.watch)
        guided.watch = None
        guided.glove.switch(testing=guided.tested_before, filtering=None)


_CODES = {Step.FIST: BENT * len(FINGERS), Step.OPEN: STRAIGHT * len(FINGERS)}
_TO_SHOW = {
    Step.FIST: "Make a fist",
    Step.OPEN: "Open the hand, fingers straight",
    Step.GESTURE: "Show the gesture",
}


def _message(guided: Guided) -> Message:
    guide, outcome = guided.guide, guided.outcome
    if outcome is not None:
        if outcome["problem"]:
            return Message("calibration.failed", outcome["problem"])
        if outcome["applied"]:
            return Message("calibration.applied", "The glove fits")
        return Message("calibration.offered", "Measured; accept it to use it")
    asked = _TO_SHOW[guide.step]
    values: dict[str, str | float | list[str]] = {"gesture": guided.gesture or ""}
    if guide.phase is Phase.COUNTDOWN:
        return Message(f"calibration.{guide.step.value}.soon", asked, values)
    if guide.waits_for_change or not guide.restless:
        return Message(f"calibration.{guide.step.value}.keep", f"{asked}, and keep it still", values)
    fingers = ", ".join(guide.restless)
    return Message(
        "calibration.restless",
        f"{asked}, and keep it still: {fingers} moved",
        {"fingers": list(guide.restless)},
    )
