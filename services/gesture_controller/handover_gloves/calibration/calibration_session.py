"""Calibration sessions: calibrations of worn gloves, and their results.

During a session the glove is in testing mode, so no gesture answers a Task. The result is applied at once, or
stored as an offer until somebody accepts it; both survive a restart. A session that a restart interrupts is
reported as interrupted, and the person begins again.
"""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from handover.database.outage import in_database
from handover.errors import Problem
from handover.messages import text_of
from handover.telemetry import get_logger
from handover_gloves.calibration.calibration_store import CalibrationStore
from handover_gloves.calibration.calibration_wizard import (
    HAND_STEPS,
    SAMPLE_STEPS,
    CalibrationWizard,
    Step,
    WizardPhase,
)
from handover_gloves.calibration.fitting import OFFERED, SAMPLES, calibration_from, learnt_from
from handover_gloves.calibration.glove_fits import GloveFits
from handover_gloves.calibration.samples import sample_of, with_sample
from handover_gloves.calibration.sensor_diagnostics import (
    SensorFault,
    find_lasting_faults,
    find_sensor_faults,
)
from handover_gloves.gloves.glove import Glove
from handover_gloves.gloves.known_gloves import KnownGloves
from handover_gloves.gloves.operator_messages import OperatorMessage
from handover_gloves.recognition.finger_states import BENT, STRAIGHT
from handover_gloves.recognition.levels import Calibration, CalibrationFailed, calibrate
from handover_gloves.recognition.registry import UnknownRecognizer, factory_of
from handover_gloves.recognition.thresholds import FINGERS, M2O2P_THRESHOLDS

log = get_logger(__name__)


class CalibrationSession:
    """One calibration of one glove: its wizard, and its outcome."""

    def __init__(
        self,
        glove: Glove,
        wizard: CalibrationWizard,
        *,
        apply: bool,
        gesture: str | None,
        code: str | None,
    ) -> None:
        self.glove = glove
        self.wizard = wizard
        self.apply = apply
        self.gesture = gesture
        self.code = code
        self.person = glove.person
        self.was_testing = glove.modes.testing
        self.outcome: dict[str, Any] | None = None
        """Once it is over: whether it was `applied`, or the `problem`; and `sensorWarnings`."""
        self.watcher: Callable[[bool], None] | None = None

    def view(self) -> dict[str, Any]:
        """Return what the screen shows."""
        wizard = self.wizard
        return {
            "step": wizard.step.value,
            "steps": [step.value for step in wizard.steps],
            "phase": wizard.phase.value,
            "gesture": self.gesture,
            "code": self.code or _CODES[wizard.step],
            "remainingMs": round(1000 * max(wizard.remaining_s, 0.0)),
            "restless": list(wizard.restless),
            "message": _message(self).as_dict(),
            "outcome": self.outcome,
        }

    def release(self) -> None:
        """Stop watching the glove and restore its testing mode."""
        if self.watcher is not None:
            self.glove.observers.watchers.discard(self.watcher)
            self.watcher = None
            self.glove.switch(testing=self.was_testing, filtering=None)


class CalibrationSessions:
    """All calibration sessions, at most one for each glove."""

    def __init__(self, gloves: KnownGloves, fits: GloveFits, store: CalibrationStore) -> None:
        self._fits = fits
        self._store = store
        self._sessions: dict[str, CalibrationSession] = {}
        self._ending: set[asyncio.Task[None]] = set()
        self._writing = asyncio.Lock()
        self._interrupted = store.unfinished()
        """By glove, the gesture of a session that a restart interrupted."""
        for glove in gloves:
            self._report_interruption(glove)
        gloves.on_added.append(self._report_interruption)

    async def begin(
        self, glove: Glove, *, gesture: str | None, apply: bool, countdown_s: float
    ) -> dict[str, Any]:
        """Begin a session for fist and open hand, or for a sample of `gesture`; raises `Problem`.

        A current session of the glove is replaced.
        """
        if not glove.is_connected:
            raise Problem.translated(
                409,
                "Glove away",
                "calibration.glove_away",
                "{glove} is not connected; put it on and switch it on",
                glove=glove.name,
            )
        if glove.observers.accuracy_test is not None:
            raise Problem.translated(
                409,
                "Test on its way",
                "calibration.test_running",
                "an accuracy test is on its way with {glove}; stop it first",
                glove=glove.name,
            )
        code = None
        if gesture is not None:
            code = _code_of(glove, gesture)
            _calibration_of(glove)
        self._drop(glove)
        wizard = CalibrationWizard(HAND_STEPS if gesture is None else SAMPLE_STEPS, countdown_s)
        session = CalibrationSession(glove, wizard, apply=apply, gesture=gesture, code=code)
        glove.switch(testing=True, filtering=None)
        session.watcher = lambda _: self._advance(session)
        glove.observers.watchers.add(session.watcher)
        self._sessions[glove.name] = session
        glove.observers.calibration = session.view
        async with self._writing:
            await in_database(self._store.begin_calibration, glove.name, gesture)
        return session.view()

    async def stop(self, glove: Glove) -> None:
        """Cancel the session of `glove`, if there is one; nothing is changed by it."""
        if self._drop(glove):
            async with self._writing:
                if glove.name not in self._sessions:
                    await in_database(self._store.end_calibration, glove.name)

    def view(self, glove: Glove) -> dict[str, Any] | None:
        """Return the view of the current or last session of `glove`."""
        session = self._sessions.get(glove.name)
        return None if session is None else session.view()

    async def accept(self, glove: Glove) -> None:
        """Apply the calibration that was offered; raise `Problem` 409 if there is none."""
        offered = self._fits.records.fit_of(glove).learnt.get(OFFERED)
        calibration = None
        if isinstance(offered, dict):
            thresholds = M2O2P_THRESHOLDS.with_changes(offered.get("thresholds", {}))
            calibration = calibration_from(offered, thresholds)
        if calibration is None:
            raise Problem.translated(
                409,
                "Nothing offered",
                "calibration.nothing_offered",
                "no calibration of {glove} waits to be accepted",
                glove=glove.name,
            )
        await self._fits.use_calibration(glove, calibration)

    async def add_sample(self, glove: Glove, gesture: str, frames: Sequence[Sequence[float]]) -> Calibration:
        """Store `frames` (five raw values each) as a sample of `gesture` (name or code); raises `Problem`."""
        code, calibration = _code_of(glove, gesture), _calibration_of(glove)
        try:
            sampled = with_sample(calibration, sample_of(code, frames, calibration.levels))
        except CalibrationFailed as error:
            raise Problem(422, "Sample failed", text_of(error)) from None
        await self._save_samples(glove, sampled)
        return sampled

    async def remove_sample(self, glove: Glove, gesture: str) -> None:
        """Delete the sample of `gesture`; raise `Problem` 404 if there is none."""
        code, calibration = _code_of(glove, gesture), _calibration_of(glove)
        others = tuple(sample for sample in calibration.samples if sample.code != code)
        if len(others) == len(calibration.samples):
            raise Problem.translated(
                404,
                "No sample",
                "calibration.no_sample",
                'there is no sample of "{gesture}" for {glove}',
                gesture=gesture,
                glove=glove.name,
            )
        await self._save_samples(glove, replace(calibration, samples=others))

    async def choose_recognizer(self, glove: Glove, recognizer: str) -> None:
        """Store and apply the recognizer of `glove` for its wearer; raises `Problem` 422."""
        try:
            factory_of(recognizer)
        except UnknownRecognizer as error:
            raise Problem(422, "Unknown recognizer", text_of(error)) from None
        records = self._fits.records
        await records.save_fit(glove, replace(records.fit_of(glove), recognizer=recognizer))
        self._fits.apply(glove)

    def summary(self, glove: Glove) -> dict[str, Any]:
        """Return the calibration of `glove` for its wearer."""
        config, fit = glove.reader.config, self._fits.records.fit_of(glove)
        calibration = config.calibration
        return {
            "recognizer": config.recognizer_name,
            "missing": config.missing,
            "thresholds": config.thresholds.as_dict(),
            "previous": fit.previous.as_dict() if fit.previous else None,
            "levels": calibration.as_dict() if calibration else None,
            "samples": learnt_from(calibration)[SAMPLES] if calibration else {},
            "sensorWarnings": [fault.as_dict() for fault in find_lasting_faults(calibration)]
            if calibration
            else [],
            "offered": OFFERED in fit.learnt,
            "changedAt": fit.changed_at or None,
        }

    def _advance(self, session: CalibrationSession) -> None:
        reader = session.glove.reader
        seen = reader.state.recognition
        if session.wizard.is_over or seen is None or reader.bend is None:
            return
        if seen.at_s == session.wizard.at_s:
            return  # there is no new frame; something else has changed
        session.wizard = session.wizard.after(reader.bend, seen.at_s)
        if session.wizard.is_over:
            ending = asyncio.get_running_loop().create_task(self._end(session))
            self._ending.add(ending)
            ending.add_done_callback(self._ending.discard)

    async def _end(self, session: CalibrationSession) -> None:
        try:
            session.outcome = await self._outcome(session)
        except Problem as problem:
            session.outcome = {"applied": False, "problem": problem.detail, "sensorWarnings": []}
        finally:
            session.release()
        await self._store_end(session)

    async def _store_end(self, session: CalibrationSession) -> None:
        """Store that the session has ended, unless a newer one of the glove has begun."""
        name = session.glove.name
        async with self._writing:
            if self._sessions.get(name) is session:
                try:
                    await in_database(self._store.end_calibration, name)
                except Problem as problem:
                    log.warning("the end of a calibration was not stored", glove=name, reason=problem.detail)

    def _drop(self, glove: Glove) -> bool:
        """Remove the session of `glove`; return False if there is none."""
        session = self._sessions.pop(glove.name, None)
        glove.observers.calibration = None
        if session is not None:
            session.release()
        return session is not None

    def _report_interruption(self, glove: Glove) -> None:
        if glove.name not in self._interrupted:
            return
        gesture = self._interrupted.pop(glove.name)
        code = None if gesture is None else glove.reader.config.gestures.codes.get(gesture)
        steps = HAND_STEPS if gesture is None else SAMPLE_STEPS
        wizard = CalibrationWizard(steps, phase=WizardPhase.INTERRUPTED)
        session = CalibrationSession(glove, wizard, apply=False, gesture=gesture, code=code)
        shown = "showing the fist and the open hand" if gesture is None else f'showing "{gesture}"'
        session.outcome = _result(
            False, f"the controller stopped while you were {shown}; nothing was changed, begin again", []
        )
        self._sessions[glove.name] = session
        glove.observers.calibration = session.view

    async def _outcome(self, session: CalibrationSession) -> dict[str, Any]:
        glove, wizard = session.glove, session.wizard
        if wizard.phase is WizardPhase.GIVEN_UP:
            raise Problem.translated(
                409,
                "Given up",
                "calibration.hand_not_still",
                "the hand was never still; begin again when you are ready",
            )
        if glove.person != session.person:
            raise Problem.translated(
                409,
                "Somebody else",
                "calibration.wearer_changed",
                "somebody else wears the glove by now; begin again",
            )
        if session.gesture is not None:
            await self.add_sample(glove, session.gesture, wizard.captured[0])
            return {"applied": True, "problem": None, "sensorWarnings": []}
        fist, open_hand = wizard.hand()
        faults = find_sensor_faults(fist, open_hand)
        try:
            calibration = await asyncio.to_thread(calibrate, fist, open_hand)
        except CalibrationFailed as error:
            return _result(False, str(error), faults)
        if not session.apply:
            records = self._fits.records
            fit = records.fit_of(glove)
            offered = {"thresholds": calibration.thresholds.as_dict(), **learnt_from(calibration)}
            await records.save_fit(glove, replace(fit, learnt={**fit.learnt, OFFERED: offered}))
            return {**_result(False, None, faults), "offered": offered}
        await self._fits.use_calibration(glove, calibration)
        log.info("hand calibrated", glove=glove.name, sensor_faults=len(faults))
        return _result(True, None, faults)

    async def _save_samples(self, glove: Glove, calibration: Calibration) -> None:
        records = self._fits.records
        fit = records.fit_of(glove)
        learnt = {**fit.learnt, SAMPLES: learnt_from(calibration)[SAMPLES]}
        await records.save_fit(glove, replace(fit, learnt=learnt))
        self._fits.apply(glove)


def _code_of(glove: Glove, gesture: str) -> str:
    gestures = glove.reader.config.gestures
    name = gestures.find(gesture) or gestures.names.get(gesture)
    code = gestures.codes.get(name or "")
    if code is None:
        raise Problem.translated(
            422,
            "Unknown gesture",
            "calibration.unknown_gesture",
            'there is no gesture "{gesture}"; {hint}',
            gesture=gesture,
            hint=gestures.like(gesture),
        )
    return code


def _calibration_of(glove: Glove) -> Calibration:
    calibration = glove.reader.config.calibration
    if calibration is None:
        raise Problem.translated(
            409,
            "Not calibrated",
            "calibration.not_calibrated",
            "{glove} knows no fist and open hand of {person} yet; calibrate it with them first",
            glove=glove.name,
            person=glove.person or "who wears it",
        )
    return calibration


def _result(applied: bool, problem: str | None, faults: Sequence[SensorFault]) -> dict[str, Any]:
    return {"applied": applied, "problem": problem, "sensorWarnings": [fault.as_dict() for fault in faults]}


_CODES = {Step.FIST: BENT * len(FINGERS), Step.OPEN: STRAIGHT * len(FINGERS)}
_INSTRUCTIONS = {
    Step.FIST: "Make a fist",
    Step.OPEN: "Open the hand, fingers straight",
    Step.GESTURE: "Show the gesture",
}


def _message(session: CalibrationSession) -> OperatorMessage:
    wizard, outcome = session.wizard, session.outcome
    if outcome is not None:
        if outcome["problem"]:
            return OperatorMessage("calibration.failed", outcome["problem"])
        if outcome["applied"]:
            return OperatorMessage("calibration.applied", "The glove fits")
        return OperatorMessage("calibration.offered", "Measured; accept it to use it")
    instruction = _INSTRUCTIONS[wizard.step]
    values: dict[str, str | float | list[str]] = {"gesture": session.gesture or ""}
    if wizard.phase is WizardPhase.COUNTDOWN:
        return OperatorMessage(f"calibration.{wizard.step.value}.soon", instruction, values)
    if wizard.waits_for_change or not wizard.restless:
        text = f"{instruction}, and keep it still"
        return OperatorMessage(f"calibration.{wizard.step.value}.keep", text, values)
    fingers = ", ".join(wizard.restless)
    return OperatorMessage(
        "calibration.restless",
        f"{instruction}, and keep it still: {fingers} moved",
        {"fingers": list(wizard.restless)},
    )
