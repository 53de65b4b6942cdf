"""The gloves of a site: those of the gestures file, those declared over REST, and any that says hello."""

import asyncio
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from handover.errors import Problem
from handover.messages import message, text_of
from handover.telemetry import get_logger
from services.gesture_controller import metrics
from services.gesture_controller.admission import Admission, NotAdmitted, hash_of, new_token
from services.gesture_controller.calibration.fitting import (
    OFFERED,
    SAMPLES,
    calibration_from,
    learnt_from,
)
from services.gesture_controller.calibration.levels import Calibration, CalibrationFailed, calibrate
from services.gesture_controller.configuration import GloveConfiguration
from services.gesture_controller.frames import Hello, is_glove_name
from services.gesture_controller.gestures import Commands, codes_in_use
from services.gesture_controller.glove import Glove
from services.gesture_controller.glove_store import NOBODY, Fit, GloveStore, StoredGlove
from services.gesture_controller.listener import Link, Listener
from services.gesture_controller.people.people import People, on_disk
from services.gesture_controller.people.person import Person
from services.gesture_controller.pipeline import Senses
from services.gesture_controller.settings import ControllerSettings
from services.gesture_controller.thresholds import Thresholds, WrongThreshold

log = get_logger(__name__)


class TooManyGloves(NotAdmitted):
    """Every slot for gloves is taken; the message says what to change."""

    def __init__(self, reason: str) -> None:
        super().__init__("too many gloves", reason, retry=True)


@dataclass(frozen=True, slots=True)
class StudyCondition:
    """Whose gestures a participant is asked for: their `own`, the site's, or as always (None)."""

    participant: str
    """The pseudonym."""
    glove: str | None
    person: str | None
    own: bool | None = None

    def meets(self, other: "StudyCondition") -> bool:
        """Say whether both are about the same glove or the same person."""
        same_glove = self.glove is not None and self.glove == other.glove
        return same_glove or (self.person is not None and self.person == other.person)


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
        self._conditions: dict[str, StudyCondition] = {}
        """By the session of a study; the newest of a glove or a person counts."""
        self._listener = listener
        self._adopted = adopted
        self.newcomers: list[Callable[[Glove], None]] = []
        """Called with each glove that becomes known from now on."""
        self._gloves: dict[str, Glove] = {}
        self._stored: dict[str, StoredGlove] = store.load()
        self._fits: dict[tuple[str, str], Fit] = store.fits()
        self._tokens = store.tokens
        self.admission = Admission(settings, self._tokens)
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
            raise Problem(
                404,
                "Unknown glove",
                message(
                    "glove.unknown_glove",
                    'there is no glove "{name}"; known: {known}',
                    name=name,
                    known=known,
                ),
            )
        return self._gloves[name]

    def connect(self, hello: Hello, link: Link, now_s: float) -> Glove:
        """Return the glove that says `hello` over `link`, a new one if need be; raises `NotAdmitted`."""
        self.admission.require_token(hello)
        glove = self._gloves.get(hello.glove)
        if glove is None:
            if not self.is_declared(hello.glove):
                undeclared = sum(not self.is_declared(name) for name in self._gloves)
                self.admission.require_slot(hello.glove, undeclared)
            glove = self._make_room_for(GloveConfiguration(hello.glove, hello.hand))
        glove.connect(link, hello, now_s)
        self.count()
        return glove

    def is_declared(self, name: str) -> bool:
        """Say whether a person made the glove known: in the gestures file, over REST or by calibrating it."""
        return name in self._stored or any(expected.name == name for expected in self.people.site.gloves)

    def absent(self, now_s: float) -> list[Glove]:
        """Return the gloves that nobody declared, that have been away for long and that nothing waits for."""
        return [
            glove
            for name, glove in self._gloves.items()
            if glove.link is None
            and math.isfinite(glove.last_s)  # else it is just being declared
            and now_s - glove.last_s >= self._settings.glove_forget_s
            and not (glove.errand or glove.partner or glove.paused or glove.examination)
            and not self.is_declared(name)
        ]

    def forget(self, glove: Glove) -> None:
        """Know `glove` no more, until it says hello again."""
        if self._gloves.get(glove.name) is glove:
            del self._gloves[glove.name]
            glove.forgotten.set()
            log.info("glove forgotten", glove=glove.name, away_s=self._settings.glove_forget_s)

    async def set_token(self, name: str) -> str:
        """Return a new token for the glove called `name`, which is declared by it and may be a new one."""
        if name not in self._gloves:
            await self.declare(name, None, None)
        glove, token = self.named(name), new_token()
        await self._keep(replace(self._stored_of(glove), declared=True))
        await self._change_token(glove, hash_of(token), "give the glove the new one")
        return token

    async def remove_token(self, glove: Glove) -> None:
        """Know `glove` by no token of its own; raise `Problem` 404 if it has none."""
        if not self.admission.has_token(glove.name):
            raise Problem(
                404,
                "No token",
                message("glove.no_token", "{glove} has no token of its own", glove=glove.name),
            )
        await self._change_token(glove, None, "it has none of its own any more")

    async def _change_token(self, glove: Glove, sha256: str | None, what_now: str) -> None:
        async with self._writing:
            await on_disk(lambda: self._tokens.save(glove.name, sha256))
            self.admission.set_hash(glove.name, sha256)
        if glove.link is not None:
            glove.link.end(f"the token of {glove.name} was changed; {what_now}")

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
            raise Problem(
                422,
                "Wrong name",
                message(
                    "glove.wrong_name", 'a glove cannot be called "{name}"; {rule}', name=name, rule=rule
                ),
            )
        known = self._gloves.get(name)
        if known is not None:
            if hand not in {None, known.hand} or person not in {None, known.person}:
                raise Problem(
                    409,
                    "Known otherwise",
                    message(
                        "glove.known_otherwise",
                        "{name} is the {hand} glove of {person}; declare another name, or choose who "
                        "wears it with PUT /gloves/{name}/person",
                        name=name,
                        hand=known.hand,
                        person=known.person or "nobody",
                    ),
                )
            return known, False
        worn = next((one for one in self.worn_by(person) if one.hand == (hand or "right")), None)
        if worn is not None:
            raise Problem(
                409,
                "Worn already",
                message(
                    "glove.worn_already",
                    "{person} wears {worn}; a person wears one {hand} glove, so take that off first "
                    "(PUT /gloves/{worn}/person) or declare one of the other hand",
                    person=person,
                    worn=worn.name,
                    hand=worn.hand,
                ),
            )
        try:
            glove = self._make_room_for(GloveConfiguration(name, hand or "right", person))
        except TooManyGloves as error:
            raise Problem(409, "Too many gloves", text_of(error)) from None
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

    async def apply_condition(self, session: str, condition: "StudyCondition", *, is_restart: bool) -> None:
        """Ask a participant for the gestures of their condition from the next Task on, with any glove.

        The participant wears the glove of the session from now on; after a restart of the service the glove
        stays with its wearer, since a session that was left may be old. Older sessions of the same glove or
        person count no longer.
        """
        self._conditions = {
            key: one for key, one in self._conditions.items() if key != session and not one.meets(condition)
        } | {session: condition}
        glove = self._gloves.get(condition.glove or "")
        if glove is not None and condition.person is not None and not is_restart:
            await self.wear(glove, condition.person)
        self._equip_all()

    def end_condition(self, session: str) -> None:
        """Ask for everybody's own gestures again where `session` has decided that."""
        if self._conditions.pop(session, None) is not None:
            self._equip_all()

    def condition_of(self, glove: Glove) -> "StudyCondition | None":
        """Return the condition under which `glove` is asked for gestures, if a study sets one."""
        return self._condition(glove.name, glove.person)

    def require_free(self, *, glove: str | None = None, person: str | None = None) -> None:
        """Raise `Problem` 409 if a study has set whose gestures are asked of one of them."""
        condition = self._condition(glove, person)
        if condition is not None:
            raise Problem(
                409,
                "Study under way",
                message(
                    "people.in_study",
                    "{participant} tries gestures in a study, so what {who} shows cannot change until this "
                    "part is over; finish it on the page Study, or delete the session there",
                    participant=condition.participant,
                    who=person or glove,
                ),
            )

    def _condition(self, glove: str | None, person: str | None) -> "StudyCondition | None":
        asked = StudyCondition("", glove, person)
        found = (one for one in self._conditions.values() if one.meets(asked) and one.own is not None)
        return next(found, None)

    def _equip_all(self) -> None:
        for glove in self:
            self.equip(glove)

    def _commands_of(self, glove: str, person: str | None) -> Commands:
        """Return the commands as they are given with `glove`: a study may set that the site's count."""
        condition = self._condition(glove, person)
        return self.people.commands_of(None if condition is not None and not condition.own else person)

    def equip_again(self, person: str) -> None:
        """Let the gloves of `person` read their hands with what is theirs now."""
        for glove in self.worn_by(person):
            self.equip(glove)

    def equip(self, glove: Glove) -> None:
        """Have `glove` know the gestures of who wears it, and that of the Task in hand as it was asked."""
        gestures = self.people.gestures_of(glove.person)
        if glove.errand is not None:
            gestures = gestures.with_parts(glove.errand.asked.all_parts)
        glove.equip(gestures, self._commands_of(glove.name, glove.person))

    async def set_thresholds(self, glove: Glove, changes: Mapping[str, Mapping[str, float]]) -> None:
        """Read `glove` with `changes` to its thresholds from now on, and keep them; raises `Problem` 422."""
        try:
            async with self._fitting:
                await self._read_with(glove, glove.senses.thresholds.with_changes(changes))
        except WrongThreshold as error:
            raise Problem(422, "Wrong threshold", text_of(error)) from None

    async def calibrate(
        self, glove: Glove, fist: Sequence[Sequence[float]], open_hand: Sequence[Sequence[float]]
    ) -> Calibration:
        """Give `glove` the thresholds that follow from the frames, and keep them; raises `Problem` 422."""
        try:
            calibration = await asyncio.to_thread(calibrate, fist, open_hand)
        except CalibrationFailed as error:
            raise Problem(422, "Calibration failed", text_of(error)) from None
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
                    409,
                    "Nothing to restore",
                    message(
                        "glove.nothing_to_restore",
                        "the thresholds of {glove}{whose} were never changed",
                        glove=glove.name,
                        whose=whose,
                    ),
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
                message(
                    "glove.too_many",
                    "this controller serves {limit} gloves at most; raise HANDOVER_MAX_GLOVES",
                    limit=self._settings.max_gloves,
                )
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
            commands=self._commands_of(expected.name, person),
            filtering=self._settings.filtering,
            listener=self._listener,
        )
        glove.other_hand = lambda: self.partner_of(glove)
        self._gloves[glove.name] = glove
        self._adopted(glove)
        for welcome in self.newcomers:
            welcome(glove)
        return glove

    def _senses(self, glove: str, person: str | None, thresholds: Thresholds, like: Senses) -> Senses:
        """Return `like` as what is kept of how `glove` fits `person` makes it."""
        fit = self._fits.get((glove, person or NOBODY), Fit())
        return replace(
            like,
            thresholds=thresholds,
            calibration=calibration_from(fit.learnt, thresholds),
            recognizer=fit.recognizer or self._settings.recognizer,
            in_use=codes_in_use(like.gestures, self._commands_of(glove, person)),
            failure=None,
        )

    def _thresholds_for(self, glove: str, person: str | None) -> Thresholds | None:
        """Return the thresholds for `person`, else those that served last, whoever wore the glove."""
        own = self._fits.get((glove, person or NOBODY))
        if own is not None and own.thresholds is not None:
            return own.thresholds
        others = [fit for (name, _), fit in self._fits.items() if name == glove and fit.thresholds]
        return max(others, key=lambda fit: fit.changed_at).thresholds if others else None
