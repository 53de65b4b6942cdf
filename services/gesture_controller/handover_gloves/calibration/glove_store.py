"""The glove store: gloves and their fits in the database of the controller.

Gloves that an earlier version kept as files in the data directory are imported once, unless the database
already has them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import orjson
from sqlalchemy import Connection, Engine, Row, delete, insert, select

from handover.database.migrations import migrate
from handover.errors import UsageError
from handover.telemetry import get_logger
from handover_datamodels.times import iso
from handover_gloves import tables
from handover_gloves.recognition.thresholds import M2O2P_THRESHOLDS, Thresholds

log = get_logger(__name__)

NOBODY = ""
"""The person of a glove whose wearer is not named."""


@dataclass(frozen=True, slots=True)
class StoredGlove:
    """The stored properties of a glove: hand, wearer, and whether it was declared over REST.

    `person` is None until a wearer was chosen; the gestures file then decides. `NOBODY` is a choice as well.
    """

    name: str
    hand: str = "right"
    person: str | None = None
    declared: bool = False


@dataclass(frozen=True, slots=True)
class Fit:
    """How a glove fits a person; None means never set.

    `previous` holds the thresholds before the last change, `recognizer` the name of the chosen recognizer,
    and `learnt` the results of calibrations as JSON values by topic (see `fitting`).
    """

    thresholds: Thresholds | None = None
    previous: Thresholds | None = None
    recognizer: str | None = None
    learnt: Mapping[str, Any] = field(default_factory=dict)
    changed_at: str = ""


class GloveStore:
    """Gloves and fits in the database; every method blocks on the database."""

    def __init__(self, engine: Engine, old_files: Path | None = None) -> None:
        self._engine = engine
        self._old_files = old_files

    def load(self) -> dict[str, StoredGlove]:
        """Return all stored gloves by name; raise `UsageError` if an old file cannot be read."""
        migrate(
            self._engine,
            tables.tables,
            component="controller_people",
            version=tables.VERSION,
        )
        self._import_files()
        with self._engine.connect() as connection:
            rows = connection.execute(select(tables.gloves).order_by(tables.gloves.c.name)).all()
        return {row.name: StoredGlove(row.name, row.hand, row.person, row.declared) for row in rows}

    def fits(self) -> dict[tuple[str, str], Fit]:
        """Return all fits by glove and person (`NOBODY` if none is named)."""
        with self._engine.connect() as connection:
            rows = connection.execute(select(tables.fits)).all()
        return {(row.glove, row.person): _fit(row) for row in rows}

    def save(self, *gloves: StoredGlove) -> None:
        """Write `gloves` in one transaction."""
        with self._engine.begin() as connection:
            for glove in gloves:
                _save(connection, glove)

    def save_fit(self, glove: StoredGlove, person: str | None, fit: Fit) -> Fit:
        """Write the fit of `glove` on `person`, and the glove itself; return the fit as stored."""
        kept = replace(fit, changed_at=iso(datetime.now(UTC)))
        with self._engine.begin() as connection:
            _save(connection, glove)
            _save_fit(connection, glove.name, person, kept)
        return kept

    def _import_files(self) -> None:
        files = sorted(self._old_files.glob("*.json")) if self._old_files else []
        if not files:
            return
        with self._engine.begin() as connection:
            names = set(connection.scalars(select(tables.gloves.c.name)))
            for file in files:
                if file.stem not in names:
                    glove, person, fit = _old_glove(file)
                    _save(connection, glove)
                    if fit.thresholds is not None:
                        _save_fit(connection, glove.name, person, fit)
                    log.info("glove imported from its file", glove=glove.name, file=str(file))


def replace_fits(connection: Connection, person: str, fits: Mapping[str, Fit]) -> dict[str, Fit]:
    """Write the fits of `person` by glove in place of all stored ones; return them as stored."""
    now = iso(datetime.now(UTC))
    stored = {glove: replace(fit, changed_at=now) for glove, fit in fits.items()}
    connection.execute(delete(tables.fits).where(tables.fits.c.person == person))
    for glove, fit in stored.items():
        _save_fit(connection, glove, person, fit)
    return stored


def _save(connection: Connection, glove: StoredGlove) -> None:
    connection.execute(delete(tables.gloves).where(tables.gloves.c.name == glove.name))
    connection.execute(
        insert(tables.gloves).values(
            name=glove.name, hand=glove.hand, person=glove.person, declared=glove.declared
        )
    )


def _save_fit(connection: Connection, glove: str, person: str | None, fit: Fit) -> None:
    whose = person or NOBODY
    connection.execute(delete(tables.fits).where(tables.fits.c.glove == glove, tables.fits.c.person == whose))
    connection.execute(
        insert(tables.fits).values(
            glove=glove,
            person=whose,
            thresholds=_written(fit.thresholds),
            previous=_written(fit.previous),
            recognizer=fit.recognizer,
            learnt=orjson.dumps(fit.learnt).decode(),
            changed_at=fit.changed_at,
        )
    )


def _fit(row: Row[Any]) -> Fit:
    return Fit(
        _thresholds(row.thresholds and orjson.loads(row.thresholds)),
        _thresholds(row.previous and orjson.loads(row.previous)),
        row.recognizer,
        orjson.loads(row.learnt),
        row.changed_at,
    )


def _old_glove(file: Path) -> tuple[StoredGlove, str | None, Fit]:
    try:
        document = orjson.loads(file.read_bytes())
        person = document["person"]
        glove = StoredGlove(
            file.stem, document["hand"], person if document["declared"] else None, document["declared"]
        )
        written_at = iso(datetime.fromtimestamp(file.stat().st_mtime, UTC))
        thresholds, previous = _thresholds(document["thresholds"]), _thresholds(document["previous"])
        fit = Fit(thresholds, previous, changed_at=written_at)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(
            f"the stored glove {file} cannot be read ({type(error).__name__}: {error}); "
            "remove the file to begin again with the thresholds of the gestures file"
        ) from None
    return glove, person, fit


def _written(thresholds: Thresholds | None) -> str | None:
    return None if thresholds is None else orjson.dumps(thresholds.as_dict()).decode()


def _thresholds(document: Any) -> Thresholds | None:
    return None if not document else M2O2P_THRESHOLDS.with_changes(document)
