"""The people of a site: those it has written down, those who wear its gloves, and those who joined since."""

import asyncio
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from handover.errors import Problem
from handover.messages import message, text_of
from handover.telemetry import get_logger
from services.gesture_controller.configuration import Configuration
from services.gesture_controller.frames import is_glove_name
from services.gesture_controller.gestures import Commands, Gestures, WrongGesture, is_code
from services.gesture_controller.people.nearness import Neighbour, neighbours, too_near
from services.gesture_controller.people.person import (
    MAX_OWN_GESTURES,
    OwnGesture,
    Person,
    WrongCommand,
    commands_of,
    gestures_of,
    what_works,
)
from services.gesture_controller.people.store import PeopleStore
from services.gesture_controller.thresholds import Thresholds

log = get_logger(__name__)

T = TypeVar("T")

LONGEST_NAME = 100


class People:
    """Everybody; `changed` is called with the name of whoever has other gestures or commands now."""

    def __init__(self, site: Configuration, store: PeopleStore) -> None:
        self.site = site
        self._store = store
        self._people: dict[str, Person] = store.load()
        self.changing = asyncio.Lock()
        """Held by whoever changes what is somebody's own: changes that come at once are all kept."""
        self.changed: Callable[[str], None] = lambda _: None
        self.also_known: Callable[[], Collection[str]] = tuple
        """Who else there is: people that wear gloves."""
        for name in self._people:
            for fault in self.faults_of(name):
                log.warning("something of a person's own does not fit this site", person=name, fault=fault)

    def names(self) -> list[str]:
        """Return the names of all people, in order."""
        expected = {glove.person for glove in self.site.gloves if glove.person}
        return sorted({*self._people, *self.site.persons, *expected, *self.also_known()})

    def named(self, name: str) -> Person:
        """Return the person called `name`; raise `Problem` 404 if nobody is."""
        if name in self._people:
            return self._people[name]
        known = self.names()
        if name in known:
            return Person(name)
        raise Problem(
            404,
            "Unknown person",
            message(
                "people.unknown_person",
                'there is nobody called "{name}"; known: {known}. Add them with PUT /people/{name}',
                name=name,
                known=", ".join(known) or "nobody yet",
            ),
        )

    def gestures_of(self, name: str | None) -> Gestures:
        """Return the gestures that a person can make: the site's and their own."""
        return self._what_works(name)[0]

    def commands_of(self, name: str | None) -> Commands:
        """Return the commands as a person gives them."""
        return self._what_works(name)[1]

    def faults_of(self, name: str) -> list[str]:
        """Return what is a person's own and does not fit the site's file as it is now."""
        return self._what_works(name)[2]

    async def add(self, name: str, title: str | None) -> bool:
        """Make a person known, or call them otherwise; return whether they are new."""
        async with self.changing:
            is_new = name not in self.names()
            if is_new:
                require_person_name(name)
            known = self._people.get(name) or Person(name)
            await self._keep(replace(known, title=known.title if title is None else title or None))
        return is_new

    async def remove(self, name: str) -> None:
        """Forget what is a person's own, their gloves' fits included; raise `Problem` 404 if nobody is so."""
        self.named(name)
        async with self.changing:
            await on_disk(lambda: self._store.remove(name))
            self._people.pop(name, None)
        self.changed(name)

    async def give_commands(self, name: str, commands: Mapping[int, str | None], *, whole: bool) -> None:
        """Take `commands` for how a person gives them; `whole`: and no other is their own any more.

        Raises `Problem` 422 for a gesture that is unknown or stands for two commands.
        """
        async with self.changing:
            before = {} if whole else self.named(name).commands
            await self._give_commands(self.named(name), {**before, **commands})

    async def take_command_back(self, name: str, command: int) -> None:
        """Let a person give `command` as the site has it; raise `Problem` 404 if they do already."""
        async with self.changing:
            person = self.named(name)
            if command not in person.commands:
                raise Problem(
                    404,
                    "Not their own",
                    message(
                        "people.command_of_site",
                        "{name} gives the command {command} as the site has it",
                        name=name,
                        command=command,
                    ),
                )
            left = {one: gesture for one, gesture in person.commands.items() if one != command}
            await self._give_commands(person, left)

    async def define(
        self,
        name: str,
        gesture: str,
        own: OwnGesture,
        thresholds: Thresholds | None = None,
        doubtful: Collection[str] = (),
    ) -> tuple[bool, Neighbour | None]:
        """Keep a gesture of a person's own; return whether it is new, and its nearest neighbour.

        `thresholds` are those under which it was sampled, `doubtful` the fingers whose sensors are. Raises
        `Problem` 409 if it is too near another, 422 if it cannot be.
        """
        async with self.changing:
            return await self._define(self.named(name), gesture, own, thresholds, doubtful)

    async def _define(
        self,
        person: Person,
        gesture: str,
        own: OwnGesture,
        thresholds: Thresholds | None,
        doubtful: Collection[str],
    ) -> tuple[bool, Neighbour | None]:
        name = person.name
        _require_gesture_name(gesture)
        others = replace(
            person, gestures={key: one for key, one in person.gestures.items() if key != gesture}
        )
        if len(others.gestures) >= MAX_OWN_GESTURES:
            raise Problem(
                409,
                "Too many gestures",
                message(
                    "people.too_many_gestures",
                    "{name} has {limit} gestures of their own; delete one first",
                    name=name,
                    limit=MAX_OWN_GESTURES,
                ),
            )
        known, _, _ = what_works(others, self.site.gestures, self._base_commands(name))
        nearest = None
        if own.shape.code is not None and is_code(own.shape.code):
            made_with = own.sample.glove if own.sample else None
            samples = {
                key: one.sample
                for key, one in others.gestures.items()
                if one.sample is not None and one.sample.glove == made_with
            }
            near = neighbours(own.shape.code, known.codes, own.sample, thresholds, samples)
            nearest = near[0] if near else None
            doubted = too_near(own.shape.code, near, doubtful)
            if doubted is not None:
                extra = {"nearest": neighbour_view(doubted.other)} if doubted.other else None
                raise Problem(
                    409,
                    "Too near",
                    message(
                        "people.too_near",
                        '"{gesture}" cannot be kept: {why}',
                        gesture=gesture,
                        why=doubted.why,
                    ),
                    extra=extra,
                )
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

    async def drop_gesture(self, name: str, gesture: str) -> list[int]:
        """Delete a gesture of a person's own; return the commands that they give as the site has them again.

        Raises `Problem` 404 if it is not theirs, 409 if another of theirs is made of it.
        """
        async with self.changing:
            return await self._drop_gesture(self.named(name), gesture)

    async def _drop_gesture(self, person: Person, gesture: str) -> list[int]:
        name = person.name
        if gesture not in person.gestures:
            own = ", ".join(person.gestures) or "none"
            raise Problem(
                404,
                "Not their own",
                message(
                    "people.not_their_own",
                    '"{gesture}" is no gesture of {name}\'s own; those are: {own}',
                    gesture=gesture,
                    name=name,
                    own=own,
                ),
            )
        left = {key: one for key, one in person.gestures.items() if key != gesture}
        freed = [command for command, shown in person.commands.items() if shown == gesture]
        commands = {command: shown for command, shown in person.commands.items() if shown != gesture}
        changed = replace(person, gestures=left, commands=commands)
        try:
            commands_of(changed, self._base_commands(name), gestures_of(changed, self.site.gestures))
        except (WrongGesture, WrongCommand) as error:
            raise Problem(
                409,
                "In use",
                message(
                    "people.in_use",
                    '"{gesture}" cannot be deleted: {error}; change or delete that first',
                    gesture=gesture,
                    error=text_of(error),
                ),
            ) from None
        await self._keep(changed)
        return freed

    def take_in(self, person: Person) -> None:
        """Take `person`, who has been kept already, in place of whoever had that name."""
        self._people[person.name] = person
        self.changed(person.name)

    async def _give_commands(self, person: Person, own: Mapping[int, str | None]) -> None:
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
        await on_disk(lambda: self._store.save(person))
        self._people[person.name] = person
        self.changed(person.name)

    def _base_commands(self, name: str | None) -> Commands:
        return self.site.commands_of(name)

    def _what_works(self, name: str | None) -> tuple[Gestures, Commands, list[str]]:
        person = self._people.get(name) if name else None
        if person is None:
            return self.site.gestures, self._base_commands(name), []
        return what_works(person, self.site.gestures, self._base_commands(name))


def neighbour_view(neighbour: Neighbour | None) -> dict[str, Any] | None:
    """Return a neighbour as screens get it."""
    if neighbour is None:
        return None
    return {
        "gesture": neighbour.name,
        "code": neighbour.code,
        "distance": neighbour.distance,
        "fingers": list(neighbour.fingers),
        "timesNoise": neighbour.sigmas,
    }


def require_person_name(name: str) -> None:
    """Raise `Problem` 422 if a person cannot be called `name`: it becomes part of entity ids and URLs."""
    if not is_glove_name(name):
        raise Problem(
            422,
            "Wrong name",
            message(
                "people.wrong_name",
                'a person cannot be called "{name}"; a name is 1 to 64 letters, digits, ".", "_" or "-"; '
                "what people call them is the title",
                name=name[:LONGEST_NAME],
            ),
        )


def _require_gesture_name(name: str) -> None:
    if not name.strip() or len(name) > LONGEST_NAME or "/" in name or not name.isprintable() or is_code(name):
        raise Problem(
            422,
            "Wrong name",
            message(
                "people.wrong_gesture_name",
                'a gesture cannot be called "{name}"; give it 1 to {limit} characters '
                "that can be read, without a slash, and no bare code",
                name=name[:LONGEST_NAME],
                limit=LONGEST_NAME,
            ),
        )


async def on_disk(action: Callable[[], T]) -> T:
    """Return what `action` returns, run beside the event loop; raise `Problem` 503 if nothing was kept."""
    try:
        return await asyncio.to_thread(action)
    except SQLAlchemyError as error:
        log.exception("the database cannot be written")
        reason = str(getattr(error, "orig", None) or error).strip().splitlines()[0]
        raise Problem(
            503,
            "Database away",
            message(
                "people.database_away",
                "nothing was changed: the database cannot be written ({reason}); try again",
                reason=reason,
            ),
        ) from None
