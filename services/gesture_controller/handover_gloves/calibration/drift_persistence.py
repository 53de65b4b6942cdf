"""Drift persistence: the measured drift of each glove survives a restart, together with the fit it belongs
to.

Drift is written seldom: when a level has moved by `MIN_SAVED_CHANGE`, and when the controller stops. After a
crash a level is off by at most that much.
"""

from dataclasses import replace

from handover.database.outage import in_database
from handover.errors import Problem
from handover.telemetry import get_logger
from handover_gloves.calibration.calibration_store import CalibrationStore, FitKey, StoredDrift
from handover_gloves.calibration.glove_records import GloveRecords
from handover_gloves.calibration.glove_store import NOBODY
from handover_gloves.gloves.glove import Glove
from handover_gloves.gloves.known_gloves import KnownGloves
from handover_gloves.recognition.drift import Drift

log = get_logger(__name__)

SAVE_INTERVAL_S = 2.0

MIN_SAVED_CHANGE = 0.02
"""The share of the span by which a level must move before it is written again."""


class DriftPersistence:
    """Stores the drift of all gloves, and restores it when a glove becomes known."""

    def __init__(self, store: CalibrationStore, gloves: KnownGloves, records: GloveRecords) -> None:
        self._store = store
        self._known = gloves
        self._records = records
        self._stored = store.drifts()
        for glove in gloves:
            self._restore(glove)
        gloves.on_added.append(self._restore)

    async def save(self, min_change: float = MIN_SAVED_CHANGE) -> None:
        """Write the drifts that changed by more than `min_change`, a share of the span of any finger."""
        changed: dict[FitKey, StoredDrift] = {}
        for glove in self._known:
            drift = self._drift_of(glove)
            if drift is not None and self._has_changed(glove, drift, min_change):
                changed[_key(glove)] = drift
        if changed:
            try:
                await in_database(self._store.save_drifts, changed)
            except Problem as problem:
                log.warning("drift was not stored", gloves=len(changed), reason=problem.detail)
            else:
                self._stored |= changed

    def _restore(self, glove: Glove) -> None:
        stored = self._stored_for(glove)
        if stored is not None and glove.reader.config.drift_bounds is not None:
            drift = Drift(stored.offsets, stored.wants_calibration)
            glove.reader.state = replace(glove.reader.state, drift=drift)

    def _stored_for(self, glove: Glove) -> StoredDrift | None:
        """Return the stored drift of `glove` for its present fit; None if it belongs to an older fit."""
        stored = self._stored.get(_key(glove))
        is_current = stored is not None and stored.fitted_at == self._records.fit_of(glove).changed_at
        return stored if is_current else None

    def _drift_of(self, glove: Glove) -> StoredDrift | None:
        if glove.reader.config.drift_bounds is None:
            return None
        drift = glove.reader.state.drift
        return StoredDrift(drift.offsets, drift.wants_calibration, self._records.fit_of(glove).changed_at)

    def _has_changed(self, glove: Glove, now: StoredDrift, min_change: float) -> bool:
        before = self._stored_for(glove) or StoredDrift(Drift().offsets, None, now.fitted_at)
        bounds = glove.reader.config.drift_bounds
        spans = bounds.spans if bounds is not None else ()
        return before.wants_calibration != now.wants_calibration or any(
            abs(offset - stored) > min_change * span
            for offset, stored, span in zip(now.offsets, before.offsets, spans, strict=True)
        )


def _key(glove: Glove) -> FitKey:
    return glove.name, glove.person or NOBODY
