"""The gloves of a site: those of the gestures file, those declared over REST, and any that says hello."""

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence

from handover.errors import Problem
from handover.telemetry import get_logger
from services.gesture_controller import metrics
from services.gesture_controller.calibration import Calibration, CalibrationFailed, calibrate
from services.gesture_controller.configuration import Configuration, GloveConfiguration
from services.gesture_controller.frames import Hello, is_glove_name
from services.gesture_controller.glove import Glove, Link, Listener
from services.gesture_controller.glove_store import GloveStore, StoredGlove
from services.gesture_controller.pipeline import Senses
from services.gesture_controller.settings import ControllerSettings
from services.gesture_controller.thresholds import Thresholds, WrongThreshold

log = get_logger(__name__)


class TooManyGloves(ValueError):
    """There is no room for another glove; the message says what to change."""


class Gloves:
    """All gloves that are known; `adopted` is called with each new one."""

    def __init__(
        self,
        settings: ControllerSettings,
        configuration: Configuration,
        store: GloveStore,
        listener: Listener,
        adopted: Callable[[Glove], None],
    ) -> None:
        self._settings = settings
        self._configuration = configuration
        self._store = store
        self._listener = listener
        self._adopted = adopted
        self._gloves: dict[str, Glove] = {}
        self._stored: dict[str, StoredGlove] = store.load()
        self._writing = asyncio.Lock()
        for expected in configuration.gloves:
            self._adopt(expected)
        for stored in self._stored.values():
            if stored.declared and stored.name not in self._gloves:
                self._adopt(GloveConfiguration(stored.name, stored.hand, stored.person))

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
                    f"{name} is the {known.hand} glove of {known.person or 'nobody'}; it stays so while the "
                    "controller runs, so declare another name",
                )
            return known, False
        wearer = next((glove for glove in self._gloves.values() if person and glove.person == person), None)
        if wearer is not None:
            raise Problem(409, "Worn already", f"{person} wears {wearer.name}; a person wears one glove")
        try:
            glove = self._make_room_for(GloveConfiguration(name, hand or "right", person))
        except TooManyGloves as error:
            raise Problem(409, "Too many gloves", str(error)) from None
        await self._keep(StoredGlove(name, glove.hand, person, declared=True))
        return glove, True

    async def set_thresholds(self, glove: Glove, changes: Mapping[str, Mapping[str, float]]) -> None:
        """Read `glove` with `changes` to its thresholds from now on, and keep them; raises `Problem` 422."""
        try:
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
        await self._read_with(glove, calibration.thresholds)
        return calibration

    async def restore(self, glove: Glove) -> None:
        """Exchange the thresholds of `glove` with those before; raise `Problem` 409 if there are none."""
        stored = self._stored.get(glove.name)
        if stored is None or stored.previous is None:
            raise Problem(409, "Nothing to restore", f"the thresholds of {glove.name} were never changed")
        await self._read_with(glove, stored.previous)

    async def _read_with(self, glove: Glove, thresholds: Thresholds) -> None:
        before = self._stored.get(glove.name)
        await self._keep(
            StoredGlove(
                glove.name,
                glove.hand,
                glove.person,
                before.declared if before else False,
                thresholds,
                glove.senses.thresholds,
            )
        )
        glove.read_with(thresholds)

    async def _keep(self, stored: StoredGlove) -> None:
        async with self._writing:
            await asyncio.to_thread(self._store.save, stored)
            self._stored[stored.name] = stored

    def _make_room_for(self, expected: GloveConfiguration) -> Glove:
        if len(self._gloves) >= self._settings.max_gloves:
            raise TooManyGloves(
                f"this controller serves {self._settings.max_gloves} gloves at most; "
                "raise HANDOVER_MAX_GLOVES, or restart it to forget gloves that are not used"
            )
        return self._adopt(expected)

    def _adopt(self, expected: GloveConfiguration) -> Glove:
        stored = self._stored.get(expected.name)
        thresholds = expected.thresholds
        if stored is not None and stored.thresholds is not None:
            thresholds = stored.thresholds
            log.info("thresholds are those of its own calibration", glove=expected.name)
        glove = Glove(
            expected.name,
            hand=expected.hand,
            person=expected.person,
            senses=Senses(thresholds, self._configuration.gestures, self._settings.timing),
            commands=self._configuration.commands_of(expected.person),
            filtering=self._settings.filtering,
            listener=self._listener,
        )
        self._gloves[glove.name] = glove
        self._adopted(glove)
        return glove
