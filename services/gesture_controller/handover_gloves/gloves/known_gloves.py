"""The gloves that the controller knows, by name."""

from collections.abc import Callable, Iterator

from handover.errors import Problem
from handover_gloves.gloves.glove import Glove


class KnownGloves:
    """All gloves that are known now."""

    def __init__(self) -> None:
        self._gloves: dict[str, Glove] = {}
        self.on_added: list[Callable[[Glove], None]] = []
        """Called with each glove that becomes known from now on."""

    def __iter__(self) -> Iterator[Glove]:
        return iter(tuple(self._gloves.values()))

    def __len__(self) -> int:
        return len(self._gloves)

    def get(self, name: str) -> Glove | None:
        """Return the glove called `name`, if it is known."""
        return self._gloves.get(name)

    def named(self, name: str) -> Glove:
        """Return the glove called `name`; raise `Problem` 404 if it is not known."""
        if name not in self._gloves:
            names = ", ".join(self._gloves) or "none yet"
            raise Problem.translated(
                404,
                "Unknown glove",
                "glove.unknown_glove",
                'there is no glove "{name}"; known: {known}',
                name=name,
                known=names,
            )
        return self._gloves[name]

    def worn_by(self, person: str | None) -> list[Glove]:
        """Return the gloves that `person` wears: connected ones first, then the right hand."""
        worn = [glove for glove in self if person and glove.person == person]
        return sorted(worn, key=lambda glove: (not glove.is_connected, glove.hand != "right"))

    def partner_of(self, glove: Glove) -> Glove | None:
        """Return the glove on the other hand of the same person; None if there is none."""
        return next((other for other in self.worn_by(glove.person) if other.hand != glove.hand), None)

    def add(self, glove: Glove) -> None:
        """Add `glove`."""
        self._gloves[glove.name] = glove
        for callback in self.on_added:
            callback(glove)

    def remove(self, glove: Glove) -> bool:
        """Remove `glove`; return False if it is not known."""
        if self._gloves.get(glove.name) is not glove:
            return False
        del self._gloves[glove.name]
        glove.observers.forgotten.set()
        return True
