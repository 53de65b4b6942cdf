"""Glove fits: thresholds, calibration and recognizer of each glove on each person, stored and applied."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from handover.errors import Problem
from handover.messages import text_of
from handover_gloves.calibration.fitting import OFFERED, SAMPLES, calibration_from, learnt_from
from handover_gloves.calibration.glove_records import GloveRecords
from handover_gloves.gloves.glove import Glove, GloveListener
from handover_gloves.recognition.levels import Calibration, CalibrationFailed, calibrate
from handover_gloves.recognition.pipeline import RecognitionConfig
from handover_gloves.recognition.thresholds import Thresholds, WrongThreshold


class GloveFits:
    """Changes fits and applies them to gloves."""

    def __init__(self, records: GloveRecords, listener: GloveListener, default_recognizer: str) -> None:
        self.records = records
        self.equip: Callable[[Glove], None] = lambda _: None
        """Gives a glove the gestures and commands of its wearer; called after every change of the fit."""
        self._listener = listener
        self._default_recognizer = default_recognizer
        self._changing = asyncio.Lock()

    async def set_thresholds(self, glove: Glove, changes: Mapping[str, Mapping[str, float]]) -> None:
        """Apply and store `changes` to the thresholds of `glove`; raises `Problem` 422."""
        try:
            async with self._changing:
                await self._use_thresholds(glove, glove.reader.config.thresholds.with_changes(changes))
        except WrongThreshold as error:
            raise Problem(422, "Wrong threshold", text_of(error)) from None

    async def calibrate(
        self, glove: Glove, fist: Sequence[Sequence[float]], open_hand: Sequence[Sequence[float]]
    ) -> Calibration:
        """Calibrate `glove` from frames, and apply and store the result; raises `Problem` 422."""
        try:
            calibration = await asyncio.to_thread(calibrate, fist, open_hand)
        except CalibrationFailed as error:
            raise Problem(422, "Calibration failed", text_of(error)) from None
        await self.use_calibration(glove, calibration)
        return calibration

    async def use_calibration(self, glove: Glove, calibration: Calibration) -> None:
        """Apply and store `calibration`; samples of gestures are kept."""
        async with self._changing:
            before = self.records.fit_of(glove)
            samples = before.learnt.get(SAMPLES, {})
            learnt = {**before.learnt, **learnt_from(calibration)}
            learnt[SAMPLES] = {**samples, **learnt[SAMPLES]}
            learnt.pop(OFFERED, None)
            fit = replace(
                before,
                thresholds=calibration.thresholds,
                previous=glove.reader.config.thresholds,
                learnt=learnt,
            )
            await self.records.save_fit(glove, fit)
            self.apply(glove)
        self._listener.calibration_restored(glove)

    async def restore(self, glove: Glove) -> None:
        """Exchange the thresholds of `glove` with the previous ones; raises `Problem` 409 without any."""
        async with self._changing:
            previous = self.records.fit_of(glove).previous
            if previous is None:
                whose = f" for {glove.person}" if glove.person else ""
                raise Problem.translated(
                    409,
                    "Nothing to restore",
                    "glove.nothing_to_restore",
                    "the thresholds of {glove}{whose} were never changed",
                    glove=glove.name,
                    whose=whose,
                )
            await self._use_thresholds(glove, previous)

    def apply(self, glove: Glove) -> None:
        """Configure `glove` with the stored fit on its wearer."""
        thresholds = self.records.fit_of(glove).thresholds or glove.reader.config.thresholds
        if glove.reader.state.drift.wants_calibration is not None:
            self._listener.calibration_restored(glove)
        glove.configure(self.config_for(glove.name, glove.person, thresholds, glove.reader.config))
        self.equip(glove)

    def config_for(
        self, glove: str, person: str | None, thresholds: Thresholds, base: RecognitionConfig
    ) -> RecognitionConfig:
        """Return `base` with the stored fit of a glove on a person, and `thresholds`."""
        fit = self.records.fit(glove, person)
        return replace(
            base,
            thresholds=thresholds,
            calibration=calibration_from(fit.learnt, thresholds),
            recognizer_name=fit.recognizer or self._default_recognizer,
            failure=None,
        )

    async def _use_thresholds(self, glove: Glove, thresholds: Thresholds) -> None:
        before = self.records.fit_of(glove)
        fit = replace(before, thresholds=thresholds, previous=glove.reader.config.thresholds)
        await self.records.save_fit(glove, fit)
        self.apply(glove)
