"""The store of people: their commands and own gestures in the database of the controller."""

from collections.abc import Iterable, Mapping
from typing import Any

import orjson
from sqlalchemy import Connection, Engine, Table, delete, insert, select

from handover.database.migrations import migrate
from handover.security.audit_trail import record_deletion, record_request
from handover_gloves import tables
from handover_gloves.calibration.glove_store import Fit, replace_fits
from handover_gloves.people.person import OwnGesture, Person, Sample
from handover_gloves.recognition.gestures import Shape


class PeopleStore:
    """People in the database; every method blocks on the database."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def load(self) -> dict[str, Person]:
        """Return all people by name."""
        migrate(self._engine, tables.tables, component="controller_people", version=tables.VERSION)
        with self._engine.connect() as connection:
            titles = {row.name: row.title for row in connection.execute(select(tables.people))}
            commands: dict[str, dict[int, str | None]] = {name: {} for name in titles}
            for row in connection.execute(select(tables.commands).order_by(tables.commands.c.command)):
                commands[row.person][row.command] = row.gesture
            gestures: dict[str, dict[str, OwnGesture]] = {name: {} for name in titles}
            for row in connection.execute(select(tables.gestures).order_by(tables.gestures.c.name)):
                gestures[row.person][row.name] = own_gesture(orjson.loads(row.shape))
        return {name: Person(name, title, commands[name], gestures[name]) for name, title in titles.items()}

    def save(self, person: Person) -> None:
        """Write `person`."""
        with self._engine.begin() as connection:
            save_person(connection, person)
            record_request(connection)

    def save_profile(self, person: Person, fits: Mapping[str, Fit]) -> dict[str, Fit]:
        """Write `person` and their fits in place of the stored ones; return the fits as stored."""
        with self._engine.begin() as connection:
            save_person(connection, person)
            record_request(connection)
            return replace_fits(connection, person.name, fits)

    def remove(self, name: str) -> None:
        """Delete a person and their fits."""
        with self._engine.begin() as connection:
            _remove(connection, name)
            connection.execute(delete(tables.fits).where(tables.fits.c.person == name))
            record_deletion(connection)


def save_person(connection: Connection, person: Person) -> None:
    """Write `person` in place of the stored one."""
    _remove(connection, person.name)
    connection.execute(insert(tables.people).values(name=person.name, title=person.title))
    _insert(
        connection,
        tables.commands,
        (
            {"person": person.name, "command": command, "gesture": gesture}
            for command, gesture in person.commands.items()
        ),
    )
    _insert(
        connection,
        tables.gestures,
        (
            {"person": person.name, "name": name, "shape": orjson.dumps(own.as_dict()).decode()}
            for name, own in person.gestures.items()
        ),
    )


def own_gesture(written: Mapping[str, Any]) -> OwnGesture:
    """Return the gesture that `OwnGesture.as_dict` has written."""
    sequence, sample = written.get("sequence"), written.get("sample")
    shape = Shape(
        written.get("code"),
        written.get("left"),
        written.get("right"),
        None if sequence is None else (sequence[0], sequence[1]),
    )
    if sample is None:
        return OwnGesture(shape)
    return OwnGesture(shape, Sample(sample["glove"], tuple(sample["levels"]), tuple(sample["noise"])))


def _insert(connection: Connection, table: Table, rows: Iterable[Mapping[str, Any]]) -> None:
    if values := list(rows):
        connection.execute(insert(table), values)


def _remove(connection: Connection, name: str) -> None:
    connection.execute(delete(tables.people).where(tables.people.c.name == name))
    connection.execute(delete(tables.commands).where(tables.commands.c.person == name))
    connection.execute(delete(tables.gestures).where(tables.gestures.c.person == name))
