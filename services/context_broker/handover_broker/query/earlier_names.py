"""Names that attributes had before: queries and subscriptions of their type accept them until 1.0.

Only short names are replaced: an IRI always means itself, so an entity that was not renamed yet is found by
the old IRI. Answers have the present names.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Final

from handover_broker.model.context import Context
from handover_broker.model.entity import Terms
from handover_datamodels.renamed import renamed_attributes

MAX_CONTEXTS: Final = 100


def with_earlier_names(context: Context, kind: str | None) -> Context:
    """Return the context in which a query of entities of one type `kind` is read.

    `kind` is a name or an IRI; a query of several types, or of none, is read in `context` itself.
    """
    if kind is None or not renamed_attributes(kind):
        return context
    return _with_earlier_names(context, context.terms.expand(kind))


def renamed(kind: str | None, names: Iterable[str]) -> frozenset[str]:
    """Return attributes (IRIs) of entities of the type `kind` with those that were renamed replaced."""
    present = {} if kind is None else renamed_attributes(kind)
    return frozenset(present.get(name, name) for name in names)


class _EarlierTerms:
    """Terms that expand the old name of an attribute to its present IRI."""

    def __init__(self, terms: Terms, present: Mapping[str, str]) -> None:
        self._terms = terms
        self._present = present
        self.compact = terms.compact

    def expand(self, term: str) -> str:
        """Return the IRI of a short name."""
        iri = self._terms.expand(term)
        return iri if ":" in term else self._present.get(iri, iri)


@lru_cache(maxsize=MAX_CONTEXTS)
def _with_earlier_names(context: Context, kind: str) -> Context:
    present = renamed_attributes(kind)
    if not present:
        return context
    # compiled queries are cached by the key: those of the context itself count from 1
    return replace(context, key=-context.key, terms=_EarlierTerms(context.terms, present))
