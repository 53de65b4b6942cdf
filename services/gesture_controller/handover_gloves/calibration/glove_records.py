"""The stored gloves and fits in memory; changes are written to the database first."""

import asyncio
from collections.abc import Mapping

from handover.database.outage import in_database
from handover_gloves.calibration.glove_store import NOBODY, Fit, GloveStore, StoredGlove
from handover_gloves.gloves.glove import Glove
from handover_gloves.recognition.thresholds import Thresholds


class GloveRecords:
    """All stored gloves and fits."""

    def __init__(self, store: GloveStore) -> None:
        self._store = store
        self._gloves = store.load()
        self._fits = store.fits()
        self.writing = asyncio.Lock()
        """Held during every change, so that memory and database agree."""

    def gloves(self) -> list[StoredGlove]:
        """Return the stored gloves."""
        return list(self._gloves.values())

    def has(self, name: str) -> bool:
        """Return True if a glove called `name` is stored."""
        return name in self._gloves

    def stored(self, name: str) -> StoredGlove | None:
        """Return the stored glove called `name`."""
        return self._gloves.get(name)

    def of(self, glove: Glove) -> StoredGlove:
        """Return what is stored of `glove`; a new record if nothing is."""
        return self._gloves.get(glove.name) or StoredGlove(glove.name, glove.hand)

    async def save(self, *gloves: StoredGlove) -> None:
        """Write `gloves`."""
        async with self.writing:
            await in_database(self._store.save, *gloves)
            self._gloves |= {glove.name: glove for glove in gloves}

    def fit(self, glove: str, person: str | None) -> Fit:
        """Return the fit of a glove on a person; an empty one if none is stored."""
        return self._fits.get((glove, person or NOBODY), Fit())

    def fit_of(self, glove: Glove) -> Fit:
        """Return the fit of `glove` on its wearer; an empty one if none is stored."""
        return self.fit(glove.name, glove.person)

    def fits_of(self, person: str) -> dict[str, Fit]:
        """Return the fits of `person` by glove."""
        return {glove: fit for (glove, whose), fit in sorted(self._fits.items()) if whose == person}

    async def save_fit(self, glove: Glove, fit: Fit) -> None:
        """Write the fit of `glove` on its wearer; recognition does not change."""
        person, stored = glove.person or NOBODY, self.of(glove)
        async with self.writing:
            written = await in_database(self._store.save_fit, stored, person, fit)
            self._gloves[glove.name] = stored
            self._fits[glove.name, person] = written

    def forget_fits(self, person: str) -> None:
        """Forget the fits of `person`, whose rows have been deleted."""
        for glove in self.fits_of(person):
            del self._fits[glove, person]

    def replace_fits(self, person: str, fits: Mapping[str, Fit]) -> None:
        """Use `fits` by glove, which have been written, in place of the fits of `person`."""
        self.forget_fits(person)
        self._fits |= {(glove, person): fit for glove, fit in fits.items()}

    def thresholds_for(self, glove: str, person: str | None) -> Thresholds | None:
        """Return the thresholds of a glove for a person, else the latest ones for anybody."""
        own = self.fit(glove, person)
        if own.thresholds is not None:
            return own.thresholds
        others = [fit for (name, _), fit in self._fits.items() if name == glove and fit.thresholds]
        return max(others, key=lambda fit: fit.changed_at).thresholds if others else None
