"""The people of a site: from the gestures file, from gloves they wear, and from REST."""

import asyncio
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import cast

from handover.database.outage import in_database
from handover.errors import Problem
from handover.messages import message, text_of
from handover.telemetry import get_logger
from handover_gloves.calibration.glove_store import Fit
from handover_gloves.configuration.gestures_file import Configuration
from handover_gloves.people.nearness import Neighbour, find_rejection, neighbours
from handover_gloves.people.person import (
    MAX_OWN_GESTURES,
    OwnGesture,
    Person,
    WrongCommand,
    commands_of,
    gestures_of,
    without_conflicts,
)
from handover_gloves.people.store import PeopleStore
from handover_gloves.people.views import Finger, NeighbourView
from handover_gloves.recognition.frames import is_glove_name
from handover_gloves.recognition.gestures import Commands, Gestures, WrongGesture, is_code
from handover_gloves.recognition.thresholds import Thresholds

log = get_logger(__name__)

MAX_NAME_LENGTH = 100


class People:
    """All people; `changed` is called with the name of a person whose gestures or commands have changed."""

    def __init__(self, site: Configuration, store: PeopleStore) -> None:
        self.site = site
        self._store = store
        self._people: dict[str, Person] = store.load()
        self.changing = asyncio.Lock()
        """Held during every change of a person, so that concurrent changes are all kept."""
        self.changed: Callable[[str], None] = lambda _: None
        self.also_known: Callable[[], Collection[str]] = tuple
        """Returns the names of people who wear gloves."""
        for name in self._people:
            for fault in self.faults_of(name):
                log.warning("a person's profile conflicts with the gestures file", person=name, fault=fault)

    def names(self) -> list[str]:
        """Return the names of all people, in order."""
        expected = {glove.person for glove in self.site.gloves if glove.person}
        return sorted({*self._people, *self.site.persons, *expected, *self.also_known()})

    def named(self, name: str) -> Person:
        """Return the person called `name`; raise `Problem` 404 if there is none."""
        if name in self._people:
            return self._people[name]
        all_names = self.names()
        if name in all_names:
            return Person(name)
        raise Problem.translated(
            404,
            "Unknown person",
            "people.unknown_person",
            'there is nobody called "{name}"; known: {known}. Add them with PUT /people/{name}',
            name=name,
            known=", ".join(all_names) or "nobody yet",
        )

    def gestures_of(self, name: str | None) -> Gestures:
        """Return the gestures of the site and the own ones of a person."""
        return self._resolved(name)[0]

    def commands_of(self, name: str | None) -> Commands:
        """Return the commands with the gestures of a person."""
        return self._resolved(name)[1]

    def faults_of(self, name: str) -> list[str]:
        """Return the conflicts of a person's profile with the gestures file."""
        return self._resolved(name)[2]

    async def add(self, name: str, title: str | None) -> bool:
        """Add a person, or change their title; return True if they are new."""
        async with self.changing:
            is_new = name not in self.names()
            if is_new:
                require_person_name(name)
            person = self._people.get(name) or Person(name)
            await self._keep(replace(person, title=person.title if title is None else title or None))
        return is_new

    async def remove(self, name: str) -> None:
        """Delete a person with their fits; raise `Problem` 404 if there is none."""
        self.named(name)
        async with self.changing:
            await in_database(self._store.remove, name)
            self._people.pop(name, None)
        self.changed(name)

    async def set_commands(self, name: str, commands: Mapping[int, str | None], *, whole: bool) -> None:
        """Set a person's gestures for `commands`; with `whole`, all other own commands are removed.

        Raises `Problem` 422 for a gesture that is unknown or has two commands.
        """
        async with self.changing:
            before = {} if whole else self.named(name).commands
            await self._set_commands(self.named(name), {**before, **commands})

    async def reset_command(self, name: str, command: int) -> None:
        """Remove a person's gesture for `command`; raise `Problem` 404 if they have none."""
        async with self.changing:
            person = self.named(name)
            if command not in person.commands:
                raise Problem.translated(
                    404,
                    "Not their own",
                    "people.command_of_site",
                    "{name} gives the command {command} as the site has it",
                    name=name,
                    command=command,
                )
            left = {key: gesture for key, gesture in person.commands.items() if key != command}
            await self._set_commands(person, left)

    async def define(
        self,
        name: str,
        gesture: str,
        own: OwnGesture,
        thresholds: Thresholds | None = None,
        unreliable: Collection[str] = (),
    ) -> tuple[bool, Neighbour | None]:
        """Store an own gesture of a person; return True if it is new, and its nearest neighbour.

        `thresholds` are those of the recording; `unreliable` names fingers with unreliable sensors. Raises
        `Problem` 409 if it is too near another gesture, 422 if it is invalid.
        """
        async with self.changing:
            return await self._define(self.named(name), gesture, own, thresholds, unreliable)

    async def _define(
        self,
        person: Person,
        gesture: str,
        own: OwnGesture,
        thresholds: Thresholds | None,
        unreliable: Collection[str],
    ) -> tuple[bool, Neighbour | None]:
        name = person.name
        _require_gesture_name(gesture)
        others = replace(
            person, gestures={key: kept for key, kept in person.gestures.items() if key != gesture}
        )
        if len(others.gestures) >= MAX_OWN_GESTURES:
            raise Problem.translated(
                409,
                "Too many gestures",
                "people.too_many_gestures",
                "{name} has {limit} gestures of their own; delete one first",
                name=name,
                limit=MAX_OWN_GESTURES,
            )
        nearest = self._nearest(others, gesture, own, thresholds, unreliable)
        changed = replace(others, gestures={**others.gestures, gesture: own})
        try:
            gestures = gestures_of(changed, self.site.gestures)
            commands_of(changed, self._base_commands(name), gestures)
        except WrongGesture as error:
            raise Problem(422, "Wrong gesture", text_of(error)) from None
        except WrongCommand as error:
            raise Problem(409, "In use", text_of(error)) from None
        await self._keep(changed)
        return gesture not in person.gestures, nearest

    def _nearest(
        self,
        others: Person,
        gesture: str,
        own: OwnGesture,
        thresholds: Thresholds | None,
        unreliable: Collection[str],
    ) -> Neighbour | None:
        """Return the gesture nearest to `own`; raise `Problem` 409 if the two would be confused."""
        if own.shape.code is None or not is_code(own.shape.code):
            return None
        usable, _, _ = without_conflicts(others, self.site.gestures, self._base_commands(others.name))
        recorded_with = own.sample.glove if own.sample else None
        samples = {
            key: other.sample
            for key, other in others.gestures.items()
            if other.sample is not None and other.sample.glove == recorded_with
        }
        near = neighbours(own.shape.code, usable.codes, own.sample, thresholds, samples)
        rejection = find_rejection(own.shape.code, near, unreliable)
        if rejection is not None:
            extra = {"nearest": neighbour_view(rejection.other)} if rejection.other else None
            raise Problem(
                409,
                "Too near",
                message(
                    "people.too_near",
                    '"{gesture}" cannot be kept: {why}',
                    gesture=gesture,
                    why=rejection.why,
                ),
                extra=extra,
            )
        return near[0] if near else None

    async def drop_gesture(self, name: str, gesture: str) -> list[int]:
        """Delete an own gesture of a person; return the commands that get the gesture of the site again.

        Raises `Problem` 404 if they do not have it, 409 if another of their gestures contains it.
        """
        async with self.changing:
            return await self._drop_gesture(self.named(name), gesture)

    async def _drop_gesture(self, person: Person, gesture: str) -> list[int]:
        name = person.name
        if gesture not in person.gestures:
            own = ", ".join(person.gestures) or "none"
            raise Problem.translated(
                404,
                "Not their own",
                "people.not_their_own",
                '"{gesture}" is no gesture of {name}\'s own; those are: {own}',
                gesture=gesture,
                name=name,
                own=own,
            )
        left = {key: kept for key, kept in person.gestures.items() if key != gesture}
        freed = [command for command, shown in person.commands.items() if shown == gesture]
        commands = {command: shown for command, shown in person.commands.items() if shown != gesture}
        changed = replace(person, gestures=left, commands=commands)
        try:
            commands_of(changed, self._base_commands(name), gestures_of(changed, self.site.gestures))
        except (WrongGesture, WrongCommand) as error:
            raise Problem.translated(
                409,
                "In use",
                "people.in_use",
                '"{gesture}" cannot be deleted: {error}; change or delete that first',
                gesture=gesture,
                error=text_of(error),
            ) from None
        await self._keep(changed)
        return freed

    async def save_profile(self, person: Person, fits: Mapping[str, Fit]) -> dict[str, Fit]:
        """Write `person` and their fits; return the fits as stored. Hold `changing`, then call `replace`."""
        return await in_database(self._store.save_profile, person, fits)

    def replace(self, person: Person) -> None:
        """Use `person`, who has been written, in place of the person of the same name."""
        self._people[person.name] = person
        self.changed(person.name)

    async def _set_commands(self, person: Person, own: Mapping[int, str | None]) -> None:
        gestures = self.gestures_of(person.name)
        in_full = {
            command: gesture if gesture is None else gestures.find(gesture) or gesture
            for command, gesture in sorted(own.items())
        }
        changed = replace(person, commands=in_full)
        try:
            commands_of(changed, self._base_commands(person.name), gestures)
        except WrongCommand as error:
            raise Problem(422, "Wrong command", text_of(error)) from None
        await self._keep(changed)

    async def _keep(self, person: Person) -> None:
        await in_database(self._store.save, person)
        self._people[person.name] = person
        self.changed(person.name)

    def _base_commands(self, name: str | None) -> Commands:
        return self.site.commands_of(name)

    def _resolved(self, name: str | None) -> tuple[Gestures, Commands, list[str]]:
        person = self._people.get(name) if name else None
        if person is None:
            return self.site.gestures, self._base_commands(name), []
        return without_conflicts(person, self.site.gestures, self._base_commands(name))


def neighbour_view(neighbour: Neighbour | None) -> NeighbourView | None:
    """Return a neighbour as in REST responses."""
    if neighbour is None:
        return None
    return {
        "gesture": neighbour.name,
        "code": neighbour.code,
        "distance": neighbour.distance,
        "fingers": cast("list[Finger]", list(neighbour.fingers)),
        "timesNoise": neighbour.sigmas,
    }


def require_person_name(name: str) -> None:
    """Raise `Problem` 422 if `name` cannot be a part of entity ids and URLs."""
    if not is_glove_name(name):
        raise Problem.translated(
            422,
            "Wrong name",
            "people.wrong_name",
            'a person cannot be called "{name}"; a name is 1 to 64 letters, digits, ".", "_" or "-"; '
            "what people call them is the title",
            name=name[:MAX_NAME_LENGTH],
        )


def _require_gesture_name(name: str) -> None:
    if (
        not name.strip()
        or len(name) > MAX_NAME_LENGTH
        or "/" in name
        or not name.isprintable()
        or is_code(name)
    ):
        raise Problem.translated(
            422,
            "Wrong name",
            "people.wrong_gesture_name",
            'a gesture cannot be called "{name}"; give it 1 to {limit} characters '
            "that can be read, without a slash, and no bare code",
            name=name[:MAX_NAME_LENGTH],
            limit=MAX_NAME_LENGTH,
        )
