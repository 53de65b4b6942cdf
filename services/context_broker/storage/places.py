"""Places: each entity's place in the order of creation, given without asking anybody.

A broker of its own counts. Brokers that share a database each count above every place they have seen, and
take every so-manyth place only, so that two of them hardly ever mean the same one; when they do, the commit
of the second is overtaken, and made again with a place further on.
"""

from typing import Final

SLOTS: Final = 1024
"""How many brokers could count beside each other without meeting."""


class Places:
    """An endless row of places; `slot` says which of those between two counts is this broker's."""

    def __init__(self, last: int, slot: int | None = None) -> None:
        self._step = 1 if slot is None else SLOTS
        self._slot = slot or 0
        self._count = last // self._step

    def __iter__(self) -> "Places":
        return self

    def __next__(self) -> int:
        self._count += 1
        return self._count * self._step + self._slot

    def seen(self, place: int) -> None:
        """Give only places after this one from now on."""
        self._count = max(self._count, place // self._step)

    def may_be_mine(self, place: int) -> bool:
        """Say whether this broker could have given a place that another one gave."""
        return place % self._step == self._slot
