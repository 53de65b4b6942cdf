"""The gloves of a site: those of the gestures file, those declared over REST, and any that says hello."""

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

from handover.errors import Problem
from handover.telemetry import get_logger
from services.gesture_controller import metrics
from services.gesture_controller.calibration.fitting import (
    OFFERED,
    SAMPLES,
    calibration_from,
    learnt_from,
)
from services.gesture_controller.calibration.levels import Calibration, CalibrationFailed, calibrate
from services.gesture_controller.configuration import GloveConfiguration
from services.gesture_controller.frames import Hello, is_glove_name
from services.gesture_controller.gestures import codes_in_use
from services.gesture_controller.glove import Glove
from services.gesture_controller.glove_store import NOBODY, Fit, GloveStore, StoredGlove
from services.gesture_controller.listener import Link, Listener
from services.gesture_controller.people.people import People, on_disk
from services.gesture_controller.people.person import Person
from services.gesture_controller.pipeline import Senses
from services.gesture_controller.settings import ControllerSettings
from services.gesture_controller.thresholds import Thresholds, WrongThreshold

log = get_logger(__name__)


class TooManyGloves(ValueError):
    """There is no room for another glove; the message says what to change."""


class Gloves:
    """All gloves that are known; `adopted` is called with each new one, and when somebody else wears one."""

    def __init__(
        self,
        settings: ControllerSettings,
        store: GloveStore,
        people: People,
        listener: Listener,
        adopted: Callable[[Glove], None],
    ) -> None:
        self._settings = settings
        self._store = store
        self.people = people
        self._shown_given: set[str] = set()
        """Gloves that are asked for the site's gestures, whatever their wearer's own are."""
        self._listener = listener
        self._adopted = adopted
        self._gloves: dict[str, Glove] = {}
        self._stored: dict[str, StoredGlove] = store.load()
        self._fits: dict[tuple[str, str], Fit] = store.fits()
        self._writing, self._dressing, self._fitting = asyncio.Lock(), asyncio.Lock(), asyncio.Lock()
        for expected in people.site.gloves:
            self._adopt(expected)
        for stored in self._stored.values():
            if (stored.declared or stored.person) and stored.name not in self._gloves:
                self._adopt(GloveConfiguration(stored.name, stored.hand, stored.person))
        people.changed = self.equip_again
        people.also_known = lambda: {glove.person for glove in self if glove.person}

    def __iter__(self) -> Iterator[Glove]:
        return iter(tuple(self._gloves.values()))

    def named(self, name: str) -> Glove:
        """Return the glove called `name`; raise `Problem` 404 if there is none."""
        if name not in self._gloves:
            known = ", ".join(self._gloves) or "none yet"
            raise Problem(404, "Unknown glove", f'there is no glove "{name}"; known: {known}')
        return self._gloves[name]

    def connect(self, hello: Hello, link: Link, now_s: float) -> Glove:
        """Return the glove that says `hello` over `link`, a new one if need be; raises `TooManyGloves`."""
        glove = self._gloves.get(hello.glove) or self._make_room_for(
            GloveConfiguration(hello.glove, hello.hand)
        )
        glove.connect(link, hello, now_s)
        self.count()
        return glove

    def count(self) -> None:
        """Put the number of connected gloves into the metrics."""
        metrics.CONNECTED.set(sum(glove.link is not None for glove in self._gloves.values()))

    async def declare(self, name: str, hand: str | None, person: str | None) -> tuple[Glove, bool]:
        """Return the glove called `name`, and whether it is new; it is known from now on, after restarts too.

        None leaves `hand` and `person` as they are known (a new glove is a right one, of nobody). Raises
        `Problem` 409 if it is known otherwise, if `person` wears another, or if there is no room.
        """
        if not is_glove_name(name):
            rule = 'a name is 1 to 64 letters, digits, ".", "_" or "-"'
            raise Problem(422, "Wrong name", f'a glove cannot be called "{name}"; {rule}')
        known = self._gloves.get(name)
        if known is not None:
            if hand not in {None, known.hand} or person not in {None, known.person}:
                raise Problem(
                    409,
                    "Known otherwise",
                    f"{name} is the {known.hand} glove of {known.person or 'nobody'}; declare another name, "
                    f"or choose who wears it with PUT /gloves/{name}/person",
                )
            return known, False
        worn = next((one for one in self.worn_by(person) if one.hand == (hand or "right")), None)
        if worn is not None:
            raise Problem(
                409,
                "Worn already",
                f"{person} wears {worn.name}; a person wears one {worn.hand} glove, so take that off first "
                f"(PUT /gloves/{worn.name}/person) or declare one of the other hand",
            )
        try:
            glove = self._make_room_for(GloveConfiguration(name, hand or "right", person))
        except TooManyGloves as error:
            raise Problem(409, "Too many gloves", str(error)) from None
        await self._keep(StoredGlove(name, glove.hand, person, declared=True))
        return glove, True

    def worn_by(self, person: str | None) -> list[Glove]:
        """Return the gloves that `person` wears: those that are connected first, the right hand's next."""
        worn = [glove for glove in self if person and glove.person == person]
        return sorted(worn, key=lambda glove: (not glove.connected, glove.hand != "right"))

    def partner_of(self, glove: Glove) -> Glove | None:
        """Return the glove on the other hand of who wears `glove`; None if there is none."""
        return next((one for one in self.worn_by(glove.person) if one.hand != glove.hand), None)

    async def wear(self, glove: Glove, person: str | None) -> None:
        """Let `person` (None: nobody by name) wear `glove` from now on; it survives a restart.

        Another glove of the same hand that they wore is nobody's then. A Task in hand stays as it was asked.
        """
        async with self._dressing:
            if person == glove.person:
                return
            taken_off = [one for one in self.worn_by(person) if one.hand == glove.hand]
            await self._keep(
                *(replace(self._stored_of(one), person=NOBODY) for one in taken_off),
                replace(self._stored_of(glove), person=person or NOBODY),
            )
            for one in taken_off:
                self._dress(one, None)
            self._dress(glove, person)
        log.info("glove is worn by somebody else", glove=glove.name, person=person or "nobody")

    def show_given(self, name: str, given: bool) -> None:
        """Have the glove called `name`, if there is one, asked for the site's gestures: whoever wears it.

        Without `given`, its wearer's own gestures are asked for again. It counts from the next Task on.
        """
        before = set(self._shown_given)
        self._shown_given = before | {name} if given else before - {name}
        if name in self._gloves and self._shown_given != before:
            self.equip(self._gloves[name])

    def equip_again(self, person: str) -> None:
        """Let the gloves of `person` read their hands with what is theirs now."""
        for glove in self.worn_by(person):
            self.equip(glove)

    def equip(self, glove: Glove) -> None:
        """Have `glove` know the gestures of who wears it, and that of the Task in hand as it was asked."""
        gestures = self.people.gestures_of(glove.person)
        if glove.errand is not None:
            gestures = gestures.with_parts(glove.errand.asked.parts)
        whose = None if glove.name in self._shown_given else glove.person
        glove.equip(gestures, self.people.commands_of(whose))

    async def set_thresholds(self, glove: Glove, changes: Mapping[str, Mapping[str, float]]) -> None:
        """Read `glove` with `changes` to its thresholds from now on, and keep them; raises `Problem` 422."""
        try:
            async with self._fitting:
                await self._read_with(glove, glove.senses.thresholds.with_changes(changes))
        except WrongThreshold as error:
            raise Problem(422, "Wrong threshold", str(error)) from None

    async def calibrate(
        self, glove: Glove, fist: Sequence[Sequence[float]], open_hand: Sequence[Sequence[float]]
    ) -> Calibration:
        """Give `glove` the thresholds that follow from the frames, and keep them; raises `Problem` 422."""
        try:
            calibration = await asyncio.to_thread(calibrate, fist, open_hand)
        except CalibrationFailed as error:
            raise Problem(422, "Calibration failed", str(error)) from None
        await self.keep_calibration(glove, calibration)
        return calibration

    async def keep_calibration(self, glove: Glove, calibration: Calibration) -> None:
        """Read `glove` with `calibration` from now on, and keep it; samples that were shown before stay."""
        async with self._fitting:
            before = self.fit_of(glove)
            samples = before.learnt.get(SAMPLES, {})
            learnt = {**before.learnt, **learnt_from(calibration)}
            learnt[SAMPLES] = {**samples, **learnt[SAMPLES]}
            learnt.pop(OFFERED, None)
            await self.keep_fit(
                glove,
                replace(
                    before,
                    thresholds=calibration.thresholds,
                    previous=glove.senses.thresholds,
                    learnt=learnt,
                ),
            )
            self.fit_again(glove)
        self._listener.fits_again(glove)

    def fit_again(self, glove: Glove) -> None:
        """Read `glove` with what is kept of how it fits who wears it, from now on."""
        thresholds = self.fit_of(glove).thresholds or glove.senses.thresholds
        if glove.sight.drift.wants_calibration is not None:
            self._listener.fits_again(glove)
        glove.sense_with(self._senses(glove.name, glove.person, thresholds, glove.senses))
        self.equip(glove)

    async def restore(self, glove: Glove) -> None:
        """Exchange the thresholds of `glove` with those before; raise `Problem` 409 if there are none."""
        async with self._fitting:
            previous = self.fit_of(glove).previous
            if previous is None:
                whose = f" for {glove.person}" if glove.person else ""
                raise Problem(
                    409, "Nothing to restore", f"the thresholds of {glove.name}{whose} were never changed"
                )
            await self._read_with(glove, previous)

    def fit_of(self, glove: Glove) -> Fit:
        """Return what is kept of how `glove` fits who wears it now; an empty one if nothing is."""
        return self._fits.get((glove.name, glove.person or NOBODY), Fit())

    async def keep_fit(self, glove: Glove, fit: Fit) -> None:
        """Keep how `glove` fits who wears it now; returns when it survives. The glove reads as it did."""
        person = glove.person or NOBODY
        stored = self._stored_of(glove)
        async with self._writing:
            kept = await on_disk(lambda: self._store.save_fit(stored, person, fit))
            self._stored[glove.name] = stored
            self._fits[glove.name, person] = kept

    def fits_of(self, person: str) -> dict[str, Fit]:
        """Return how gloves fit `person`, by the name of the glove."""
        return {glove: fit for (glove, whose), fit in sorted(self._fits.items()) if whose == person}

    def forget_fits(self, person: str) -> None:
        """Forget how gloves fit `person`, who has been removed."""
        for glove in self.fits_of(person):
            del self._fits[glove, person]

    async def take_in(self, person: Person, fits: Mapping[str, Fit]) -> None:
        """Keep `person` and how gloves fit them, in place of all that was theirs, and apply it at once."""
        async with self.people.changing, self._writing:
            kept = await on_disk(lambda: self._store.save_profile(person, fits))
            self.forget_fits(person.name)
            self._fits |= {(glove, person.name): fit for glove, fit in kept.items()}
            self.people.take_in(person)
        for glove in self.worn_by(person.name):
            self._dress(glove, person.name)

    async def _read_with(self, glove: Glove, thresholds: Thresholds) -> None:
        before = self.fit_of(glove)
        await self.keep_fit(glove, replace(before, thresholds=thresholds, previous=glove.senses.thresholds))
        self.fit_again(glove)

    async def _keep(self, *gloves: StoredGlove) -> None:
        async with self._writing:
            await on_disk(lambda: self._store.save(*gloves))
            self._stored |= {glove.name: glove for glove in gloves}

    def _stored_of(self, glove: Glove) -> StoredGlove:
        return self._stored.get(glove.name) or StoredGlove(glove.name, glove.hand)

    def _dress(self, glove: Glove, person: str | None) -> None:
        glove.person = person
        self.fit_again(glove)
        self._adopted(glove)

    def _make_room_for(self, expected: GloveConfiguration) -> Glove:
        if len(self._gloves) >= self._settings.max_gloves:
            raise TooManyGloves(
                f"this controller serves {self._settings.max_gloves} gloves at most; "
                "raise HANDOVER_MAX_GLOVES, or restart it to forget gloves that are not used"
            )
        return self._adopt(expected)

    def _adopt(self, expected: GloveConfiguration) -> Glove:
        stored = self._stored.get(expected.name)
        person = expected.person
        if stored is not None and stored.person is not None:
            person = stored.person or None
        thresholds = self._thresholds_for(expected.name, person) or expected.thresholds
        glove = Glove(
            expected.name,
            hand=expected.hand,
            person=person,
            senses=self._senses(
                expected.name,
                person,
                thresholds,
                Senses(thresholds, self.people.gestures_of(person), self._settings.timing),
            ),
            commands=self.people.commands_of(None if expected.name in self._shown_given else person),
            filtering=self._settings.filtering,
            listener=self._listener,
        )
        glove.other_hand = lambda: self.partner_of(glove)
        self._gloves[glove.name] = glove
        self._adopted(glove)
        return glove

    def _senses(self, glove: str, person: str | None, thresholds: Thresholds, like: Senses) -> Senses:
        """Return `like` as what is kept of how `glove` fits `person` makes it."""
        fit = self._fits.get((glove, person or NOBODY), Fit())
        return replace(
            like,
            thresholds=thresholds,
            calibration=calibration_from(fit.learnt, thresholds),
            recognizer=fit.recognizer or self._settings.recognizer,
            in_use=codes_in_use(like.gestures, self.people.commands_of(person)),
            failure=None,
        )

    def _thresholds_for(self, glove: str, person: str | None) -> Thresholds | None:
        """Return the thresholds for `person`, else those that served last, whoever wore the glove."""
        own = self._fits.get((glove, person or NOBODY))
        if own is not None and own.thresholds is not None:
            return own.thresholds
        others = [fit for (name, _), fit in self._fits.items() if name == glove and fit.thresholds]
        return max(others, key=lambda fit: fit.changed_at).thresholds if others else None
