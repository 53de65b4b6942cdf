"""The calibration store: drifts and unfinished calibrations, so that both survive a crash."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import orjson
from sqlalchemy import Column, Engine, MetaData, Row, String, Table, Text, delete, insert, select

from handover.database.migrations import migrate
from handover_gloves.recognition.thresholds import FINGERS

VERSION = 1

_meta = MetaData()
_drifts = Table(
    "controller_drifts",
    _meta,
    Column("glove", String(64), primary_key=True),
    Column("person", String(200), primary_key=True),  # empty: the wearer is not named
    Column("offsets", Text, nullable=False),
    Column("wants_calibration", Text),
    Column("fitted_at", String(40), nullable=False),
)
_guided = Table(
    "controller_guided",
    _meta,
    Column("glove", String(64), primary_key=True),
    Column("gesture", String(200)),  # NULL: fist and open hand
)

FitKey = tuple[str, str]
"""The names of a glove and of its wearer."""


@dataclass(frozen=True, slots=True)
class StoredDrift:
    """The drift of each level, in raw units and thumb first, since the fit of `fitted_at`.

    `wants_calibration` is the reason for which the hand should be calibrated again, if any.
    """

    offsets: tuple[float, ...]
    wants_calibration: str | None
    fitted_at: str


class CalibrationStore:
    """Drifts and unfinished calibrations in the database; every method blocks on the database."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        migrate(engine, _meta, component="controller_logbook", version=VERSION)

    def drifts(self) -> dict[FitKey, StoredDrift]:
        """Return all stored drifts."""
        with self._engine.connect() as connection:
            rows = connection.execute(select(_drifts)).all()
        return {(row.glove, row.person): _drift(row) for row in rows}

    def save_drifts(self, drifts: Mapping[FitKey, StoredDrift]) -> None:
        """Write `drifts` in place of the stored ones of the same gloves and people."""
        with self._engine.begin() as connection:
            for (glove, person), drift in drifts.items():
                row = {
                    "glove": glove,
                    "person": person,
                    "offsets": orjson.dumps(drift.offsets).decode(),
                    "wants_calibration": drift.wants_calibration,
                    "fitted_at": drift.fitted_at,
                }
                connection.execute(
                    delete(_drifts).where(_drifts.c.glove == glove, _drifts.c.person == person)
                )
                connection.execute(insert(_drifts).values(row))

    def unfinished(self) -> dict[str, str | None]:
        """Return the gloves whose calibration did not end, with the gesture; None: fist and open hand."""
        with self._engine.connect() as connection:
            return {row.glove: row.gesture for row in connection.execute(select(_guided))}

    def begin_calibration(self, glove: str, gesture: str | None) -> None:
        """Store that a calibration of `glove` has begun."""
        with self._engine.begin() as connection:
            connection.execute(delete(_guided).where(_guided.c.glove == glove))
            connection.execute(insert(_guided).values(glove=glove, gesture=gesture))

    def end_calibration(self, glove: str) -> None:
        """Store that the calibration of `glove` has ended."""
        with self._engine.begin() as connection:
            connection.execute(delete(_guided).where(_guided.c.glove == glove))


def _drift(row: Row[Any]) -> StoredDrift:
    offsets = tuple(float(offset) for offset in orjson.loads(row.offsets))
    if len(offsets) != len(FINGERS):
        raise ValueError(f"{row.glove}: a stored drift has five offsets, not {row.offsets}")
    return StoredDrift(offsets, row.wants_calibration, row.fitted_at)
