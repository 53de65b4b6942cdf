"""Type selections: `Task`, `Task,Alert` for either, `(Device;Asset)` for both.

The type selection language of clause 4.17 of ETSI GS CIM 009. `*` matches every type.
"""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any, Final

from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import require_name, shown, without_iri
from handover_broker.query.alternatives import alternatives

EVERY: Final = "*"


@dataclass(frozen=True, slots=True)
class TypeSelection:
    """Selected types (IRIs): an entity has all types of at least one of the `alternatives`.

    An alternative without types is `*`: it matches every entity.
    """

    alternatives: tuple[frozenset[str], ...]

    def wants(self, types: Collection[str]) -> bool:
        """Return whether an entity of `types` matches."""
        if len(self.alternatives) == 1:
            return self.alternatives[0].issubset(types)
        return any(alternative.issubset(types) for alternative in self.alternatives)

    @property
    def is_every(self) -> bool:
        """Return whether it matches every type."""
        return any(not alternative for alternative in self.alternatives)

    def names(self) -> Iterator[str]:
        """Yield the IRIs of all types in it."""
        for alternative in self.alternatives:
            yield from alternative

    def written(self, compact: Callable[[str], str] = str) -> str:
        """Return the selection as an expression, its names written with `compact`."""
        return ",".join(_written(sorted(map(compact, alternative))) for alternative in self.alternatives)


def type_selection(text: Any, expand: Callable[[str], str], what: str = "the type") -> TypeSelection:
    """Return the selection in `text`, its names expanded.

    Raises a problem (400) that names `what` when it is invalid.
    """
    if not isinstance(text, str) or not text:
        raise bad_request_data(f"{what} is text such as Task,Alert or (Device;Asset), not {shown(text)}")
    if text == EVERY:
        return TypeSelection((frozenset(),))

    def leaf(name: str) -> str:
        if name == EVERY:
            raise bad_request_data(f"{what} {EVERY} matches every type by itself; leave the others out")
        iri = expand(require_name(name, what))
        if ":" not in iri:
            raise without_iri(name, iri)
        return iri

    if text.isalnum():  # it is nearly always one plain name
        return TypeSelection((frozenset((leaf(text),)),))
    names = alternatives(text, what, leaf)
    return TypeSelection(tuple(dict.fromkeys(frozenset(kinds) for kinds in names)))


def of_types(types: Collection[str]) -> TypeSelection:
    """Return the selection of entities that have any of the types (IRIs)."""
    return TypeSelection(tuple(frozenset((kind,)) for kind in types))


def _written(names: list[str]) -> str:
    if not names:
        return EVERY
    return names[0] if len(names) == 1 else f"({';'.join(names)})"
