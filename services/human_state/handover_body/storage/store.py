"""Reads and writes the database. Every function blocks; changes are recorded in the audit log with them."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import orjson
from sqlalchemy import ColumnElement, Connection, Engine, case, delete, func, insert, select, update

from handover.security.audit_trail import record_deletion, record_request
from handover_body.storage import tables

MAX_HISTORY_ROWS: Final = 20_000
MAX_LASTING_US: Final = 10_000_000
VALID: Final = "valid"
_OF_PERSON: Final = (tables.consents, tables.sensors, tables.bindings, tables.limits)


@dataclass(frozen=True, slots=True)
class PersonRow:
    """A person: the name is that of the Person entity, health data has the pseudonym."""

    name: str
    pseudonym: str
    rest_bpm: float
    maximum_bpm: float
    baseline_method: str
    created_us: int


@dataclass(frozen=True, slots=True)
class ConsentRow:
    """A consent with its purposes; `withdrawn_us` is None while it was not withdrawn."""

    person: str
    purposes: frozenset[str]
    given_us: int
    ends_us: int
    given_by: str
    withdrawn_us: int | None = None


@dataclass(frozen=True, slots=True)
class SensorRow:
    """A sensor of a person: its driver and the settings of that."""

    name: str
    driver: str
    settings: Mapping[str, Any]
    person: str


@dataclass(frozen=True, slots=True)
class LimitRow:
    """The curve of a person, and whether a stop waits for a reset."""

    person: str
    free_bpm: float
    strained_bpm: float
    least: float
    is_stopped: bool


@dataclass(frozen=True, slots=True)
class ValueRow:
    """One value of the history: a number or a text."""

    subject: str
    feature: str
    at_us: int
    number: float | None
    text: str | None
    quality: float
    status: str


@dataclass(frozen=True, slots=True)
class PointRow:
    """The valid numbers of a part of the history around `at_us`."""

    at_us: int
    least: float
    mean: float
    most: float
    values: int


@dataclass(frozen=True, slots=True)
class RecordingRow:
    """A recording: until it has ended, `ended_us` and what follows is None.

    `sha256`, in hexadecimal digits, and `size` in bytes are those of the decrypted file.
    """

    id: str
    subject: str
    label: str
    started_us: int
    started_by: str
    ended_us: int | None = None
    end_reason: str | None = None
    sha256: str | None = None
    size: int | None = None
    messages: int | None = None


@dataclass(frozen=True, slots=True)
class Everything:
    """What the service has stored, besides the history."""

    persons: Sequence[PersonRow]
    consents: Sequence[ConsentRow]
    sensors: Sequence[SensorRow]
    bindings: Sequence[tuple[str, str]]
    """Robot and person."""
    limits: Sequence[LimitRow]


class Store:
    """The database."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    @contextmanager
    def _changing(self) -> Iterator[Connection]:
        with self._engine.begin() as connection:
            yield connection
            record_request(connection)

    def load(self) -> Everything:
        """Return everything besides the history; of consents the newest of each person."""
        with self._engine.connect() as connection:
            consents = {
                row["person"]: ConsentRow(
                    row["person"],
                    frozenset(orjson.loads(row["purposes"])),
                    row["given_us"],
                    row["ends_us"],
                    row["given_by"],
                    row["withdrawn_us"],
                )
                for row in connection.execute(
                    select(tables.consents).order_by(tables.consents.c.id)
                ).mappings()
            }
            return Everything(
                [PersonRow(**row) for row in connection.execute(select(tables.persons)).mappings()],
                list(consents.values()),
                [
                    SensorRow(row.name, row.driver, orjson.loads(row.settings), row.person)
                    for row in connection.execute(select(tables.sensors))
                ],
                [(row.robot, row.person) for row in connection.execute(select(tables.bindings))],
                [LimitRow(**row) for row in connection.execute(select(tables.limits)).mappings()],
            )

    def save_person(self, person: PersonRow, limit: LimitRow) -> None:
        """Insert or replace a person, with the curve."""
        with self._changing() as connection:
            connection.execute(delete(tables.persons).where(tables.persons.c.name == person.name))
            connection.execute(insert(tables.persons).values(_members(person)))
            _replace_limit(connection, limit)

    def save_limit(self, limit: LimitRow) -> None:
        """Write the curve of a person, and whether a stop waits for a reset."""
        with self._changing() as connection:
            _replace_limit(connection, limit)

    def add_consent(self, consent: ConsentRow) -> None:
        """Insert a consent; the newest one holds."""
        values = _members(consent) | {"purposes": orjson.dumps(sorted(consent.purposes)).decode()}
        with self._changing() as connection:
            connection.execute(insert(tables.consents).values(values))

    def withdraw(self, person: str, now_us: int) -> None:
        """Withdraw every consent of a person."""
        table = tables.consents
        with self._changing() as connection:
            connection.execute(
                update(table)
                .where((table.c.person == person) & table.c.withdrawn_us.is_(None))
                .values(withdrawn_us=now_us)
            )

    def save_sensor(self, sensor: SensorRow) -> None:
        """Insert or replace a sensor."""
        values = _members(sensor) | {"settings": orjson.dumps(dict(sensor.settings)).decode()}
        with self._changing() as connection:
            connection.execute(delete(tables.sensors).where(tables.sensors.c.name == sensor.name))
            connection.execute(insert(tables.sensors).values(values))

    def delete_sensor(self, name: str) -> None:
        """Delete a sensor."""
        with self._changing() as connection:
            connection.execute(delete(tables.sensors).where(tables.sensors.c.name == name))

    def save_binding(self, robot: str, person: str, *, is_bound: bool) -> None:
        """Bind a robot to a person, or end that."""
        table = tables.bindings
        with self._changing() as connection:
            here = (table.c.robot == robot) & (table.c.person == person)
            connection.execute(delete(table).where(here))
            if is_bound:
                connection.execute(insert(table).values(robot=robot, person=person))

    def delete_person(self, person: PersonRow) -> None:
        """Delete a person with everything."""
        with self._engine.begin() as connection:
            for table in _OF_PERSON:
                connection.execute(delete(table).where(table.c.person == person.name))
            connection.execute(delete(tables.persons).where(tables.persons.c.name == person.name))
            _delete_history(connection, person.pseudonym)
            record_deletion(connection)

    def delete_history(self, subject: str) -> None:
        """Delete the history of a pseudonym."""
        with self._changing() as connection:
            _delete_history(connection, subject)

    def add_values(self, rows: Iterable[ValueRow]) -> None:
        """Insert values of the history; the later of two with the same time holds."""
        unique = {(row.subject, row.feature, row.at_us): _members(row) for row in rows}
        if not unique:
            return
        table = tables.history
        with self._engine.begin() as connection:
            for subject, feature, at_us in unique:
                here = (table.c.subject == subject) & (table.c.feature == feature) & (table.c.at_us == at_us)
                connection.execute(delete(table).where(here))
            connection.execute(insert(table), list(unique.values()))

    def values(self, subject: str, feature: str, from_us: int, to_us: int) -> list[ValueRow]:
        """Return the newest values of a feature in a time, oldest first."""
        table = tables.history
        query = (
            select(table)
            .where(_within(subject, feature, from_us, to_us))
            .order_by(table.c.at_us.desc())
            .limit(MAX_HISTORY_ROWS)
        )
        with self._engine.connect() as connection:
            return [ValueRow(**row) for row in connection.execute(query).mappings()][::-1]

    def points(self, subject: str, feature: str, from_us: int, to_us: int, count: int) -> list[PointRow]:
        """Return the valid numbers of a time in at most `count` parts of equal length, oldest first."""
        table = tables.history
        width_us = max((to_us - from_us) // count + 1, 1)
        part = (table.c.at_us - from_us) // width_us
        number = table.c.number
        query = (
            select(part, func.min(number), func.avg(number), func.max(number), func.count())
            .where(_within(subject, feature, from_us, to_us))
            .where(number.is_not(None) & (table.c.status == VALID))
            .group_by(part)
            .order_by(part)
        )
        with self._engine.connect() as connection:
            points = connection.execute(query).all()
        return [
            PointRow(from_us + place * width_us + width_us // 2, least, float(mean), most, rows)
            for place, least, mean, most, rows in points
        ]

    def durations(self, subject: str, feature: str, from_us: int, to_us: int) -> list[tuple[str, float]]:
        """Return how long each valid text held in a time, in s, the longest first.

        A text holds until the next value, and for `MAX_LASTING_US` at most: the sensor was off afterwards.
        """
        table = tables.history
        following = func.lead(table.c.at_us, 1, to_us).over(order_by=table.c.at_us)
        values = (
            select(table.c.text, table.c.status, (following - table.c.at_us).label("length_us"))
            .where(_within(subject, feature, from_us, to_us))
            .subquery()
        )
        lasted = case((values.c.length_us > MAX_LASTING_US, MAX_LASTING_US), else_=values.c.length_us)
        total = func.sum(lasted)
        query = (
            select(values.c.text, total)
            .where(values.c.text.is_not(None) & (values.c.status == VALID))
            .group_by(values.c.text)
            .order_by(total.desc(), values.c.text)
        )
        with self._engine.connect() as connection:
            return [(text, float(lasted_us) / 1e6) for text, lasted_us in connection.execute(query)]

    def delete_old_values(self, before_us: int) -> int:
        """Delete values before a time; return how many."""
        with self._engine.begin() as connection:
            return connection.execute(
                delete(tables.history).where(tables.history.c.at_us < before_us)
            ).rowcount

    def recordings(self) -> list[RecordingRow]:
        """Return all recordings, oldest first."""
        query = select(tables.recordings).order_by(tables.recordings.c.started_us)
        with self._engine.connect() as connection:
            return [RecordingRow(**row) for row in connection.execute(query).mappings()]

    def save_recording(self, recording: RecordingRow) -> None:
        """Insert or replace a recording."""
        table = tables.recordings
        with self._changing() as connection:
            connection.execute(delete(table).where(table.c.id == recording.id))
            connection.execute(insert(table).values(_members(recording)))

    def delete_recording(self, identifier: str) -> None:
        """Delete the row of a recording; its file is deleted before."""
        with self._changing() as connection:
            connection.execute(delete(tables.recordings).where(tables.recordings.c.id == identifier))


def _within(subject: str, feature: str, from_us: int, to_us: int) -> ColumnElement[bool]:
    table = tables.history
    is_feature = (table.c.subject == subject) & (table.c.feature == feature)
    return is_feature & (table.c.at_us >= from_us) & (table.c.at_us <= to_us)


def _delete_history(connection: Connection, subject: str) -> None:
    connection.execute(delete(tables.history).where(tables.history.c.subject == subject))


def _replace_limit(connection: Connection, limit: LimitRow) -> None:
    connection.execute(delete(tables.limits).where(tables.limits.c.person == limit.person))
    connection.execute(insert(tables.limits).values(_members(limit)))


def _members(row: Any) -> dict[str, Any]:
    return {name: getattr(row, name) for name in row.__dataclass_fields__}
