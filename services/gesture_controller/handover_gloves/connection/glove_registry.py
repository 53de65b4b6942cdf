"""The glove registry: admits, declares and forgets gloves.

Gloves come from the gestures file, from REST declarations, and from any glove that says hello.
"""

import math
from collections.abc import Callable
from dataclasses import replace

from handover.database.outage import in_database
from handover.errors import Problem
from handover.messages import message, text_of
from handover.security.secret_tokens import new_token, token_hash
from handover.telemetry import get_logger
from handover_gloves import metrics
from handover_gloves.calibration.glove_fits import GloveFits
from handover_gloves.calibration.glove_records import GloveRecords
from handover_gloves.calibration.glove_store import GloveStore, StoredGlove
from handover_gloves.configuration.gestures_file import GloveConfiguration
from handover_gloves.connection.admission import Admission, TokenStore
from handover_gloves.gloves.connection_state import ConnectionRefused, GloveLink
from handover_gloves.gloves.gesture_responder import GestureResponder
from handover_gloves.gloves.glove import Glove, GloveListener
from handover_gloves.gloves.known_gloves import KnownGloves
from handover_gloves.people.people import People
from handover_gloves.people.study_condition_store import StudyConditionStore
from handover_gloves.people.wearers import Wearers
from handover_gloves.recognition.frames import Hello, is_glove_name
from handover_gloves.recognition.gestures import codes_in_use
from handover_gloves.recognition.pipeline import RecognitionConfig
from handover_gloves.settings import ControllerSettings

log = get_logger(__name__)


class TooManyGloves(ConnectionRefused):
    """The limit for gloves is reached; the message names the setting."""

    def __init__(self, reason: str) -> None:
        super().__init__("too many gloves", reason, retry=True)


class GloveRegistry:
    """All gloves; `adopted` is called with each new glove, and with each that somebody else wears."""

    def __init__(
        self,
        settings: ControllerSettings,
        *,
        store: GloveStore,
        tokens: TokenStore,
        people: People,
        conditions: StudyConditionStore,
        listener: GloveListener,
        adopted: Callable[[Glove], None],
    ) -> None:
        self.known = KnownGloves()
        self.records = GloveRecords(store)
        self.fits = GloveFits(self.records, listener, settings.recognizer)
        self.wearers = Wearers(self.known, self.fits, people, conditions, adopted)
        self.admission = Admission(settings, tokens)
        self._settings = settings
        self._tokens = tokens
        self._listener = listener
        self._adopted = adopted
        for expected in people.site.gloves:
            self._adopt(expected)
        for stored in self.records.gloves():
            if (stored.declared or stored.person) and self.known.get(stored.name) is None:
                self._adopt(GloveConfiguration(stored.name, stored.hand, stored.person))

    def connect(self, hello: Hello, link: GloveLink, now_s: float) -> Glove:
        """Return the glove that sent `hello` over `link`, a new one if needed; raises `ConnectionRefused`."""
        self.admission.require_token(hello)
        glove = self.known.get(hello.glove)
        if glove is None:
            if not self.is_declared(hello.glove):
                undeclared = sum(not self.is_declared(present.name) for present in self.known)
                self.admission.require_slot(hello.glove, undeclared)
            glove = self._adopt_if_allowed(GloveConfiguration(hello.glove, hello.hand))
        glove.connect(link, hello, now_s)
        self.count_connected()
        return glove

    def is_declared(self, name: str) -> bool:
        """Return True if the glove is in the gestures file, or was declared, assigned or calibrated."""
        site = self.wearers.people.site
        return self.records.has(name) or any(expected.name == name for expected in site.gloves)

    def absent(self, now_s: float) -> list[Glove]:
        """Return the undeclared gloves that have been away for `glove_forget_s` and are not in use."""
        return [
            glove
            for glove in self.known
            if glove.connection.link is None
            and math.isfinite(glove.connection.last_s)  # otherwise it is being declared at this moment
            and now_s - glove.connection.last_s >= self._settings.glove_forget_s
            and not _is_in_use(glove)
            and not self.is_declared(glove.name)
        ]

    def forget(self, glove: Glove) -> None:
        """Remove `glove` until its next hello."""
        if self.known.remove(glove):
            log.info("glove forgotten", glove=glove.name, away_s=self._settings.glove_forget_s)

    async def set_token(self, name: str) -> str:
        """Return a new token for the glove called `name`; this declares the glove, which may be new."""
        if self.known.get(name) is None:
            await self.declare(name, None, None)
        glove, token = self.known.named(name), new_token("glove")
        await self.records.save(replace(self.records.of(glove), declared=True))
        await self._change_token(glove, token_hash(token), "give the glove the new one")
        return token

    async def remove_token(self, glove: Glove) -> None:
        """Remove the token of the glove; raise `Problem` 404 if it has none."""
        if not self.admission.has_token(glove.name):
            raise Problem.translated(
                404, "No token", "glove.no_token", "{glove} has no token of its own", glove=glove.name
            )
        await self._change_token(glove, None, "it has none of its own any more")

    def count_connected(self) -> None:
        """Update the metric of connected gloves."""
        metrics.GLOVES_CONNECTED.set(sum(glove.connection.link is not None for glove in self.known))

    async def declare(self, name: str, hand: str | None, person: str | None) -> tuple[Glove, bool]:
        """Store the glove called `name`; return it, and True if it is new.

        None keeps `hand` and `person`; a new glove is a right one without a wearer. Raises `Problem` 409 if
        it is known with another hand or person, if `person` wears another one, or if the limit is reached.
        """
        if not is_glove_name(name):
            rule = 'a name is 1 to 64 letters, digits, ".", "_" or "-"'
            raise Problem.translated(
                422,
                "Wrong name",
                "glove.wrong_name",
                'a glove cannot be called "{name}"; {rule}',
                name=name,
                rule=rule,
            )
        present = self.known.get(name)
        if present is not None:
            _require_same(present, hand, person)
            return present, False
        worn = next((other for other in self.known.worn_by(person) if other.hand == (hand or "right")), None)
        if worn is not None:
            raise Problem.translated(
                409,
                "Worn already",
                "glove.worn_already",
                "{person} wears {worn}; a person wears one {hand} glove, so take that off first "
                "(PUT /gloves/{worn}/person) or declare one of the other hand",
                person=person,
                worn=worn.name,
                hand=worn.hand,
            )
        try:
            glove = self._adopt_if_allowed(GloveConfiguration(name, hand or "right", person))
        except TooManyGloves as error:
            raise Problem(409, "Too many gloves", text_of(error)) from None
        await self.records.save(StoredGlove(name, glove.hand, person, declared=True))
        return glove, True

    async def _change_token(self, glove: Glove, sha256: str | None, remedy: str) -> None:
        async with self.records.writing:
            await in_database(self._tokens.save, glove.name, sha256)
            self.admission.set_hash(glove.name, sha256)
        if glove.connection.link is not None:
            glove.connection.link.end(f"the token of {glove.name} was changed; {remedy}")

    def _adopt_if_allowed(self, expected: GloveConfiguration) -> Glove:
        if len(self.known) >= self._settings.max_gloves:
            raise TooManyGloves(
                message(
                    "glove.too_many",
                    "this controller serves {limit} gloves at most; raise HANDOVER_MAX_GLOVES",
                    limit=self._settings.max_gloves,
                )
            )
        return self._adopt(expected)

    def _adopt(self, expected: GloveConfiguration) -> Glove:
        name, person = expected.name, expected.person
        stored = self.records.stored(name)
        if stored is not None and stored.person is not None:
            person = stored.person or None
        thresholds = self.records.thresholds_for(name, person) or expected.thresholds
        gestures = self.wearers.people.gestures_of(person)
        commands = self.wearers.commands_of(name, person)
        base = RecognitionConfig(
            thresholds, gestures, self._settings.timing, in_use=codes_in_use(gestures, commands)
        )
        glove = Glove(
            name,
            hand=expected.hand,
            person=person,
            config=self.fits.config_for(name, person, thresholds, base),
            commands=commands,
            filtering=self._settings.filtering,
            listener=self._listener,
        )
        glove.responder.other_hand = lambda: _responder(self.known.partner_of(glove))
        self.known.add(glove)
        self._adopted(glove)
        return glove


def _responder(glove: Glove | None) -> GestureResponder | None:
    return None if glove is None else glove.responder


def _is_in_use(glove: Glove) -> bool:
    responder = glove.responder
    return bool(responder.prompt or responder.partner or glove.modes.paused or glove.observers.accuracy_test)


def _require_same(glove: Glove, hand: str | None, person: str | None) -> None:
    """Raise `Problem` 409 if a known glove is declared with another hand or person."""
    if hand in {None, glove.hand} and person in {None, glove.person}:
        return
    raise Problem.translated(
        409,
        "Known otherwise",
        "glove.known_otherwise",
        "{name} is the {hand} glove of {person}; declare another name, or choose who "
        "wears it with PUT /gloves/{name}/person",
        name=glove.name,
        hand=glove.hand,
        person=glove.person or "nobody",
    )
