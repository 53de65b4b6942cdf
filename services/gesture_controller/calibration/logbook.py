"""The logbook: what is going on with a calibration, kept so that a controller that is killed can go on.

How far levels have drifted since the fit that they belong to, and which gloves are being guided.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import orjson
from sqlalchemy import Column, Engine, MetaData, Row, String, Table, Text, delete, insert, select

from handover.migrations import migrate
from services.gesture_controller.thresholds import FINGERS

VERSION = 1

_meta = MetaData()
_drifts = Table(
    "controller_drifts",
    _meta,
    Column("glove", String(64), primary_key=True),
    Column("person", String(200), primary_key=True),  # empty: whoever wears it without saying so
    Column("offsets", Text, nullable=False),
    Column("wants_calibration", Text),
    Column("fitted_at", String(40), nullable=False),
)
_guided = Table(
    "controller_guided",
    _meta,
    Column("glove", String(64), primary_key=True),
    Column("gesture", String(200)),  # absent: fist and open hand
)

Whose = tuple[str, str]
"""A glove and who wears it, by name."""


@dataclass(frozen=True, slots=True)
class KeptDrift:
    """How far levels have moved, in raw units and thumb first, since the fit that was kept at `fitted_at`.

    `wants_calibration` says why the hand should be calibrated again, if it should.
    """

    offsets: tuple[float, ...]
    wants_calibration: str | None
    fitted_at: str


class Logbook:
    """Drifts and guides in the database; every method blocks for the disk."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        migrate(engine, _meta, component="controller_logbook", version=VERSION)

    def drifts(self) -> dict[Whose, KeptDrift]:
        """Return what is kept of all drifts."""
        with self._engine.connect() as connection:
            rows = connection.execute(select(_drifts)).all()
        return {(row.glove, row.person): _drift(row) for row in rows}

    def keep(self, drifts: Mapping[Whose, KeptDrift]) -> None:
        """Keep `drifts` in place of what was kept of the same gloves on the same people."""
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

    def guided(self) -> dict[str, str | None]:
        """Return by glove which gesture it was being guided to show; None for fist and open hand."""
        with self._engine.connect() as connection:
            return {row.glove: row.gesture for row in connection.execute(select(_guided))}

    def guide_began(self, glove: str, gesture: str | None) -> None:
        """Keep that `glove` is being guided."""
        with self._engine.begin() as connection:
            connection.execute(delete(_guided).where(_guided.c.glove == glove))
            connection.execute(insert(_guided).values(glove=glove, gesture=gesture))

    def guide_ended(self, glove: str) -> None:
        """Forget that `glove` was being guided."""
        with self._engine.begin() as connection:
            connection.execute(delete(_guided).where(_guided.c.glove == glove))


def _drift(row: Row[Any]) -> KeptDrift:
    offsets = tuple(float(offset) for offset in orjson.loads(row.offsets))
    if len(offsets) != len(FINGERS):
        raise ValueError(f"{row.glove}: five offsets are kept for a glove, not {row.offsets}")
    return KeptDrift(offsets, row.wants_calibration, row.fitted_at)
