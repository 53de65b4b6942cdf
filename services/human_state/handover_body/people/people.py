"""The persons whose body is sensed: changed in the database first, then here.

One event loop uses it; a change waits for the one before.
"""

import asyncio
import secrets
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from handover.errors import Problem
from handover_body.fusion.baseline import Baseline
from handover_body.people.consent import MAX_CONSENT_DAYS, Consent, Purpose
from handover_body.storage.store import ConsentRow, LimitRow, PersonRow, SensorRow, Store

DEFAULT_LEAST: Final = 0.2
MAX_PERSONS: Final = 1000
MAX_SENSORS: Final = 16


def now_us() -> int:
    """Return the present time in microseconds since 1970."""
    return time.time_ns() // 1000


@dataclass(frozen=True, slots=True)
class Person:
    """A person with consent, sensors, robots and curve."""

    row: PersonRow
    limit: LimitRow
    consent: Consent = field(default_factory=Consent)
    sensors: Mapping[str, SensorRow] = field(default_factory=dict)
    robots: frozenset[str] = frozenset()

    @property
    def name(self) -> str:
        """The name of the Person."""
        return self.row.name

    @property
    def pseudonym(self) -> str:
        """The pseudonym, which all health data has."""
        return self.row.pseudonym

    @property
    def baseline(self) -> Baseline:
        """The heart rates at rest and at most."""
        return Baseline(self.row.rest_bpm, self.row.maximum_bpm, self.row.baseline_method)

    def purposes(self) -> frozenset[Purpose]:
        """Return what the person allows now."""
        return self.consent.purposes(now_us())


class People:
    """All persons by name. `on_changed` is called after each change."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._persons: dict[str, Person] = {}
        self._turn = asyncio.Lock()
        self.on_changed: Callable[[str], None] = lambda _: None

    async def load(self) -> None:
        """Read what was stored."""
        stored = await asyncio.to_thread(self._store.load)
        limits = {limit.person: limit for limit in stored.limits}
        consents = {given_consent.person: given_consent for given_consent in stored.consents}
        for row in stored.persons:
            self._persons[row.name] = Person(
                row,
                limits[row.name],
                Consent(consents.get(row.name)),
                {worn.name: worn for worn in stored.sensors if worn.person == row.name},
                frozenset(robot for robot, person in stored.bindings if person == row.name),
            )

    def all(self) -> list[Person]:
        """Return all persons in the order of their names."""
        return sorted(self._persons.values(), key=lambda candidate: candidate.name)

    def find(self, name: str) -> Person | None:
        """Return a person; None if there is none."""
        return self._persons.get(name)

    def person(self, name: str) -> Person:
        """Return a person; raise `Problem` 404."""
        match = self._persons.get(name)
        if match is None:
            raise Problem.translated(
                404,
                "Unknown person",
                "health.unknown_person",
                'no body signals of "{person}" are known; add the person first',
                person=name,
            )
        return match

    def stored_settings(self, name: str, driver: str) -> Mapping[str, Any]:
        """Return the settings of a sensor; none if it is not there or has another driver."""
        rows = (person.sensors[name] for person in self._persons.values() if name in person.sensors)
        return next((row.settings for row in rows if row.driver == driver), {})

    def sensor(self, name: str) -> SensorRow:
        """Return a sensor; raise `Problem` 404."""
        for person in self._persons.values():
            if name in person.sensors:
                return person.sensors[name]
        raise Problem.translated(
            404,
            "Unknown sensor",
            "health.unknown_sensor",
            'there is no body sensor "{sensor}"; add it to a person',
            sensor=name,
        )

    async def put(self, name: str, baseline: Baseline, curve: tuple[float, float, float]) -> Person:
        """Add or change a person: baseline, and curve (free, strained bpm, least fraction)."""
        async with self._turn:
            before = self._persons.get(name)
            if before is None and len(self._persons) >= MAX_PERSONS:
                raise Problem(409, "Too many persons", f"at most {MAX_PERSONS} persons; delete one first")
            pseudonym = f"P-{secrets.token_hex(4)}" if before is None else before.pseudonym
            created = now_us() if before is None else before.row.created_us
            row = PersonRow(
                name, pseudonym, baseline.rest_bpm, baseline.maximum_bpm, baseline.method, created
            )
            limit = LimitRow(name, *curve, is_stopped=before is not None and before.limit.is_stopped)
            await asyncio.to_thread(self._store.save_person, row, limit)
            changed = Person(row, limit) if before is None else replace(before, row=row, limit=limit)
            return self._set(changed)

    async def consent(self, name: str, purposes: frozenset[Purpose], ends_us: int, given_by: str) -> Person:
        """Store a consent, which replaces the one before. Raises `Problem`."""
        async with self._turn:
            person, given_us = self.person(name), now_us()
            if Purpose.LIVE not in purposes:
                raise Problem.translated(
                    422,
                    "No consent",
                    "health.live_required",
                    'every purpose requires "live"; add it to the purposes',
                )
            if not given_us < ends_us <= given_us + MAX_CONSENT_DAYS * 86_400_000_000:
                raise Problem.translated(
                    422,
                    "No end",
                    "health.consent_end",
                    "a consent ends in the future, within {days} days; give another end",
                    days=int(MAX_CONSENT_DAYS),
                )
            row = ConsentRow(name, frozenset(purposes), given_us, ends_us, given_by[:200])
            await asyncio.to_thread(self._store.add_consent, row)
            return self._set(replace(person, consent=Consent(row)))

    async def withdraw(self, name: str) -> Person:
        """Withdraw the consent: processing stops at once, and robots that are bound to the person stop."""
        async with self._turn:
            person, at_us = self.person(name), now_us()
            row = person.consent.row
            if row is None:
                return person
            # before the database: nothing more is processed while it is written
            withdrawn = self._set(replace(person, consent=Consent(replace(row, withdrawn_us=at_us))))
            await asyncio.to_thread(self._store.withdraw, name, at_us)
            return withdrawn

    async def put_sensor(self, sensor: SensorRow) -> Person:
        """Give a person a sensor; it is taken from another one."""
        async with self._turn:
            person = self.person(sensor.person)
            if sensor.name not in person.sensors and len(person.sensors) >= MAX_SENSORS:
                raise Problem(
                    409, "Too many sensors", f"a person has at most {MAX_SENSORS} sensors; remove one first"
                )
            await asyncio.to_thread(self._store.save_sensor, sensor)
            for other in self.all():
                if other.name != sensor.person and sensor.name in other.sensors:
                    self._set(replace(other, sensors=_without(other.sensors, sensor.name)))
            return self._set(replace(person, sensors={**person.sensors, sensor.name: sensor}))

    async def remove_sensor(self, name: str) -> None:
        """Take a sensor away from its person."""
        async with self._turn:
            sensor = self.sensor(name)
            await asyncio.to_thread(self._store.delete_sensor, name)
            person = self._persons[sensor.person]
            self._set(replace(person, sensors=_without(person.sensors, name)))

    async def bind(self, name: str, robot: str, *, is_bound: bool) -> Person:
        """Bind a robot to a person, or end that."""
        async with self._turn:
            person = self.person(name)
            if is_bound and Purpose.SPEED_LIMITS not in person.purposes():
                raise Problem.translated(
                    409,
                    "No consent",
                    "health.no_limit_consent",
                    "{person} does not consent to speed limits; ask the person, then bind the robot",
                    person=name,
                )
            await asyncio.to_thread(self._store.save_binding, robot, name, is_bound=is_bound)
            robots = person.robots | {robot} if is_bound else person.robots - {robot}
            return self._set(replace(person, robots=robots))

    async def keep_stop(self, name: str, *, is_stopped: bool) -> None:
        """Store whether a stop waits for a reset, so that a restart does not end it."""
        async with self._turn:
            person = self._persons.get(name)
            if person is None or person.limit.is_stopped == is_stopped:
                return
            limit = replace(person.limit, is_stopped=is_stopped)
            await asyncio.to_thread(self._store.save_limit, limit)
            self._persons[name] = replace(person, limit=limit)

    async def delete(self, name: str) -> Person:
        """Delete a person with everything that is stored here; return what was known."""
        async with self._turn:
            person = self.person(name)
            del self._persons[name]
            self.on_changed(name)  # nothing more is processed while it is deleted
            await asyncio.to_thread(self._store.delete_person, person.row)
            return person

    def _set(self, person: Person) -> Person:
        self._persons[person.name] = person
        self.on_changed(person.name)
        return person


def _without(sensors: Mapping[str, Any], name: str) -> dict[str, Any]:
    return {key: value for key, value in sensors.items() if key != name}
