"""Keeping: the drift that was followed outlives the controller, as the fit does that it belongs to.

It is written seldom: when a level has moved far enough to be seen, and when the controller stops. So a
controller that is killed begins at most `KEEP_FROM` of a span away from where it was.
"""

from dataclasses import replace

from handover.errors import Problem
from handover.telemetry import get_logger
from services.gesture_controller.calibration.drift import Drift
from services.gesture_controller.calibration.logbook import KeptDrift, Logbook, Whose
from services.gesture_controller.glove import Glove
from services.gesture_controller.glove_store import NOBODY
from services.gesture_controller.gloves import Gloves
from services.gesture_controller.people.people import on_disk

log = get_logger(__name__)

KEEP_EVERY_S = 2.0
"""How often somebody looks whether there is anything to keep."""

KEEP_FROM = 0.02
"""A level that has moved by so much of its span since it was kept is kept again."""


class Keeping:
    """Keeps how far the levels of all gloves have drifted, and has gloves begin there."""

    def __init__(self, logbook: Logbook, gloves: Gloves) -> None:
        self._logbook = logbook
        self._gloves = gloves
        self._kept = logbook.drifts()
        for glove in gloves:
            self._take_up(glove)
        gloves.newcomers.append(self._take_up)

    async def keep(self, least: float = KEEP_FROM) -> None:
        """Keep the drifts that have changed by more than `least`, a share of the span of any finger."""
        changed: dict[Whose, KeptDrift] = {}
        for glove in self._gloves:
            drift = self._drift_of(glove)
            if drift is not None and self._has_changed(glove, drift, least):
                changed[_whose(glove)] = drift
        if changed:
            try:
                await on_disk(lambda: self._logbook.keep(changed))
            except Problem as problem:
                log.warning("drift was not kept", gloves=len(changed), why=problem.detail)
            else:
                self._kept |= changed

    def _take_up(self, glove: Glove) -> None:
        kept = self._kept_of(glove)
        if kept is not None and glove.senses.rooms is not None:
            glove.sight = replace(glove.sight, drift=Drift(kept.offsets, kept.wants_calibration))

    def _kept_of(self, glove: Glove) -> KeptDrift | None:
        """Return what is kept for `glove` as it fits who wears it now; drift since an older fit is none."""
        kept = self._kept.get(_whose(glove))
        return kept if kept is not None and kept.fitted_at == self._gloves.fit_of(glove).changed_at else None

    def _drift_of(self, glove: Glove) -> KeptDrift | None:
        if glove.senses.rooms is None:
            return None
        drift = glove.sight.drift
        return KeptDrift(drift.offsets, drift.wants_calibration, self._gloves.fit_of(glove).changed_at)

    def _has_changed(self, glove: Glove, now: KeptDrift, least: float) -> bool:
        before = self._kept_of(glove) or KeptDrift(Drift().offsets, None, now.fitted_at)
        spans = glove.senses.rooms.spans if glove.senses.rooms is not None else ()
        return before.wants_calibration != now.wants_calibration or any(
            abs(moved - kept) > least * span
            for moved, kept, span in zip(now.offsets, before.offsets, spans, strict=True)
        )


def _whose(glove: Glove) -> Whose:
    return glove.name, glove.person or NOBODY
