"""Wearers: which person wears which glove, and the gestures and commands that each glove gets from it."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace

from handover.database.outage import in_database
from handover.telemetry import get_logger
from handover_gloves.calibration.glove_fits import GloveFits
from handover_gloves.calibration.glove_store import NOBODY, Fit
from handover_gloves.gloves.glove import Glove
from handover_gloves.gloves.known_gloves import KnownGloves
from handover_gloves.people.people import People
from handover_gloves.people.person import Person
from handover_gloves.people.study_condition_store import StudyConditionStore
from handover_gloves.people.study_conditions import StudyCondition, StudyConditions
from handover_gloves.recognition.gestures import Commands

log = get_logger(__name__)


class Wearers:
    """Assigns gloves to people; `wearer_changed` is called with each glove that somebody else wears."""

    def __init__(
        self,
        gloves: KnownGloves,
        fits: GloveFits,
        people: People,
        condition_store: StudyConditionStore,
        wearer_changed: Callable[[Glove], None],
    ) -> None:
        self.people = people
        self.conditions = StudyConditions(condition_store.load())
        self._condition_store = condition_store
        self._changing_conditions = asyncio.Lock()
        self._known = gloves
        self._fits = fits
        self._wearer_changed = wearer_changed
        self._assigning = asyncio.Lock()
        fits.equip = self.equip
        people.changed = self._equip_worn_by
        people.also_known = lambda: {glove.person for glove in gloves if glove.person}

    async def wear(self, glove: Glove, person: str | None) -> None:
        """Store that `person` (None: nobody by name) wears `glove` from now on.

        Another glove of the same hand that they wore has no wearer then. A current Task stays unchanged.
        """
        async with self._assigning:
            if person == glove.person:
                return
            records = self._fits.records
            taken_off = [removed for removed in self._known.worn_by(person) if removed.hand == glove.hand]
            await records.save(
                *(replace(records.of(removed), person=NOBODY) for removed in taken_off),
                replace(records.of(glove), person=person or NOBODY),
            )
            for removed in taken_off:
                self._assign(removed, None)
            self._assign(glove, person)
        log.info("glove has another wearer", glove=glove.name, person=person or "nobody")

    async def import_profile(self, person: Person, fits: Mapping[str, Fit]) -> None:
        """Store and apply `person` and their fits in place of everything stored for them."""
        async with self.people.changing, self._fits.records.writing:
            stored = await self.people.save_profile(person, fits)
            self._fits.records.replace_fits(person.name, stored)
            self.people.replace(person)
        for glove in self._known.worn_by(person.name):
            self._assign(glove, person.name)

    async def apply_condition(self, session: str, condition: StudyCondition) -> None:
        """Store a condition, and ask its participant for the gestures from the next Task on, with any glove.

        The participant wears the glove of the session from now on, if the person is known. A repeated
        condition changes nothing: an old session that was never finished does not change the wearer again.
        """
        async with self._changing_conditions:
            if self.conditions.get(session) == condition:
                return
            self.conditions.set(session, condition)
            await self._save_conditions()
            glove, person = self._known.get(condition.glove or ""), condition.person
            if glove is not None and person is not None and person in self.people.names():
                await self.wear(glove, person)
            self._equip_all()

    async def end_condition(self, session: str) -> None:
        """Ask for everybody's usual gestures again."""
        async with self._changing_conditions:
            if self.conditions.remove(session):
                await self._save_conditions()
                self._equip_all()

    async def _save_conditions(self) -> None:
        conditions = dict(self.conditions.items())
        await in_database(self._condition_store.replace, conditions)

    def condition_of(self, glove: Glove) -> StudyCondition | None:
        """Return the study condition that applies to `glove`, if any."""
        return self.conditions.find(glove.name, glove.person)

    def commands_of(self, glove: str, person: str | None) -> Commands:
        """Return the commands of a glove on a person; a study condition may select those of the site."""
        condition = self.conditions.find(glove, person)
        return self.people.commands_of(None if condition is not None and not condition.own else person)

    def equip(self, glove: Glove) -> None:
        """Give `glove` the gestures and commands of its wearer; the current prompt stays unchanged."""
        gestures = self.people.gestures_of(glove.person)
        if glove.responder.prompt is not None:
            gestures = gestures.with_parts(glove.responder.prompt.spec.all_parts)
        glove.equip(gestures, self.commands_of(glove.name, glove.person))

    def _equip_worn_by(self, person: str) -> None:
        for glove in self._known.worn_by(person):
            self.equip(glove)

    def _equip_all(self) -> None:
        for glove in self._known:
            self.equip(glove)

    def _assign(self, glove: Glove, person: str | None) -> None:
        glove.person = person
        self._fits.apply(glove)
        self._wearer_changed(glove)
