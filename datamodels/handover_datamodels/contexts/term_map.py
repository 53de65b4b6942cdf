"""Term maps: from the terms of an @context to IRIs, and back.

This is no complete JSON-LD processor: NGSI-LD needs only terms, prefixes and `@vocab` for names of types and
attributes. The core context is applied last and cannot be overridden (ETSI GS CIM 009, clause 4.4), so scoped
contexts are refused (clause 5.5.7). A lookup is a dictionary lookup, since the broker needs several for each
request.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache
from typing import Any, Final, TypeAlias
from urllib.parse import urljoin

from handover_datamodels.contexts.shipped import CORE_URL, resolve
from handover_datamodels.errors import DataModelError

Context: TypeAlias = str | Mapping[str, Any] | Sequence[Any] | None
"""The URL of a context, a context (or its document), or a list of these."""

Loader: TypeAlias = Callable[[str], Mapping[str, Any] | None]
"""Returns the document of a URL; None if it is not available."""

DEFAULT_VOCAB: Final = "https://uri.etsi.org/ngsi-ld/default-context/"

_MAX_REMEMBERED, _MAX_REMEMBERED_CHARACTERS = 4096, 256
"""Cached names (and their maximum length) in addition to those of the context; bounds the memory."""
_MOST_DOCUMENTS = 100
_DELIMITERS = (":", "/", "?", "#", "[", "]", "@")


class ContextNotAvailable(DataModelError):
    """The context at `url` is not available."""

    def __init__(self, url: str) -> None:
        super().__init__(
            f"the @context {url} is not shipped with Handover and was not loaded; "
            "send its terms instead of the URL, or a URL that is reachable"
        )
        self.url = url


class TermMap:
    """The IRIs of the terms of a context and of the core context.

    `load` returns documents by URL; by default only the shipped ones are available. Raises
    `ContextNotAvailable` with the URL that `load` did not find, `DataModelError` for an invalid context.
    """

    __slots__ = ("_iris", "_max_terms", "_prefixes", "_terms", "vocab")

    def __init__(self, context: Context, load: Loader = resolve) -> None:
        reading = _Reading(load)
        try:
            reading.take(context)
        except RecursionError:
            raise _too_deep() from None
        core = _core_terms()
        own = {term: iri for term, iri in reading.terms.items() if iri is not None}
        self.vocab: str = reading.vocab or DEFAULT_VOCAB
        self._iris: dict[str, str] = own | core
        self._terms = _shortest_terms(self._iris)
        self._max_terms = len(self._iris) + _MAX_REMEMBERED
        self._prefixes = sorted(
            ((iri, term) for term, iri in self._iris.items() if iri.endswith(_DELIMITERS)),
            key=lambda prefix: (-len(prefix[0]), len(prefix[1]), prefix[1]),
        )

    def expand(self, term: str) -> str:
        """Return the IRI of a term, of `prefix:suffix` or of an IRI (itself); unknown terms go under `vocab`.

        `id` and `type` give the JSON-LD keywords they stand for.
        """
        iri = self._iris.get(term)
        return iri if iri is not None else self._learn(term)

    def compact(self, iri: str) -> str:
        """Return the shortest name whose expansion is `iri`; `iri` itself if there is no shorter one."""
        term = self._terms.get(iri)
        return term if term is not None else self._learn_back(iri)

    def _learn(self, term: str) -> str:
        iri = self._work_out(term)
        if len(self._iris) < self._max_terms and len(term) <= _MAX_REMEMBERED_CHARACTERS:
            self._iris[term] = iri
        return iri

    def _work_out(self, term: str) -> str:
        if term.startswith("@"):
            return term
        prefix, colon, suffix = term.partition(":")
        if not colon:
            return self.vocab + term
        base = self._iris.get(prefix) if prefix and not suffix.startswith("//") else None
        return term if base is None or base.startswith("@") else base + suffix

    def _learn_back(self, iri: str) -> str:
        name = self._shorten(iri)
        if len(self._terms) < self._max_terms and len(iri) <= _MAX_REMEMBERED_CHARACTERS:
            self._terms[iri] = name
        return name

    def _shorten(self, iri: str) -> str:
        if iri.startswith(self.vocab):
            name = iri[len(self.vocab) :]
            if name and self.expand(name) == iri:
                return name
        for base, prefix in self._prefixes:
            if iri.startswith(base) and len(iri) > len(base):
                name = f"{prefix}:{iri[len(base) :]}"
                if self.expand(name) == iri:
                    return name
        return iri


@lru_cache(maxsize=256)
def _term_map_of(context: str) -> TermMap:
    return TermMap(json.loads(context))


@lru_cache(maxsize=256)
def _term_map_at(url: str) -> TermMap:
    return TermMap(url)


def term_map(context: Context) -> TermMap:
    """Return the term map of a context that needs only shipped documents; cached for equal contexts."""
    if isinstance(context, str):
        return _term_map_at(context)
    try:
        written = json.dumps(context, sort_keys=True)
    except RecursionError:
        raise _too_deep() from None
    return _term_map_of(written)


class _Reading:
    """The definitions that were read so far; later contexts override earlier ones."""

    def __init__(self, load: Loader) -> None:
        self.terms: dict[str, str | None] = {}
        self.vocab: str | None = DEFAULT_VOCAB
        self._load = load
        self._documents = 0

    def take(self, context: Context, within: tuple[str, ...] = ()) -> None:
        """Read a context of the documents `within` (the outermost first)."""
        if context is None:
            self.terms, self.vocab = {}, DEFAULT_VOCAB
        elif isinstance(context, str):
            self._take_document(urljoin(within[-1], context) if within else context, within)
        elif isinstance(context, Mapping):
            if "@context" in context:  # a whole document
                self.take(context["@context"], within)
            else:
                self._take_definitions(context, within)
        elif isinstance(context, Sequence):
            for part in context:
                self.take(part, within)
        else:
            raise DataModelError(f"an @context is a URL, an object or a list of both, not {context!r}")

    def _take_document(self, url: str, within: tuple[str, ...]) -> None:
        self._documents += 1
        if url in within or self._documents > _MOST_DOCUMENTS:
            raise DataModelError(f"the @context {url} refers to itself or to too many others; simplify it")
        document: Any = self._load(url)
        if document is None:
            raise ContextNotAvailable(url)
        if not isinstance(document, Mapping) or "@context" not in document:
            raise DataModelError(f'the document at {url} has no "@context"; use the URL of a JSON-LD context')
        self.take(document["@context"], (*within, url))

    def _take_definitions(self, context: Mapping[str, Any], within: tuple[str, ...]) -> None:
        if "@import" in context:
            self.take(context["@import"], within)
        definitions = {term: meant for term, meant in context.items() if not term.startswith("@")}
        begun: dict[str, bool] = {}
        if "@vocab" in context:
            vocab = context["@vocab"]
            if vocab is not None and not isinstance(vocab, str):
                raise DataModelError(f"the @vocab of an @context is an IRI, not {vocab!r}")
            self.vocab = self._iri(vocab, definitions, begun) if vocab else None
        for term in definitions:
            self._define(term, definitions, begun)

    def _define(self, term: str, definitions: Mapping[str, Any], begun: dict[str, bool]) -> None:
        """Read the definition of `term` unless it was read; `begun` has the state of each term."""
        if term in begun:
            if not begun[term]:  # JSON-LD 1.1 calls it a cyclic IRI mapping
                raise DataModelError(
                    f'the term "{term}" of an @context is defined by itself; define it with a complete IRI'
                )
            return
        begun[term] = False
        self.terms.pop(term, None)
        meant = definitions[term]
        if isinstance(meant, Mapping):
            if meant.get("@context") is not None and term not in _core_terms():  # the core has one of its own
                raise DataModelError(
                    f'the term "{term}" of an @context has a scoped context, which could give '
                    "terms of NGSI-LD another meaning; define its terms beside it"
                )
            meant = meant["@id"] if "@id" in meant else self._unnamed(term, meant)
        if meant is not None and not isinstance(meant, str):
            raise DataModelError(f'the term "{term}" of an @context must be an IRI, not {meant!r}')
        if meant == term and ":" not in term:
            self.terms[term] = (self.vocab or DEFAULT_VOCAB) + term
        else:
            self.terms[term] = None if meant is None else self._iri(meant, definitions, begun, term)
        begun[term] = True

    @staticmethod
    def _unnamed(term: str, meant: Mapping[str, Any]) -> str | None:
        """Return the IRI of a definition without `@id`: the expanded term; None for a reverse property."""
        return None if "@reverse" in meant else term

    def _iri(
        self, meant: str, definitions: Mapping[str, Any], begun: dict[str, bool], term: str | None = None
    ) -> str:
        """Return the IRI of `meant`, in the definition of `term` if given."""
        if meant.startswith("@"):
            return meant
        if meant in definitions and meant != term:
            self._define(meant, definitions, begun)
        if (defined := self.terms.get(meant)) is not None:
            return defined
        prefix, colon, suffix = meant.partition(":")
        if not colon:
            return (self.vocab or DEFAULT_VOCAB) + meant
        if suffix.startswith("//") or not prefix:
            return meant
        if prefix in definitions:
            self._define(prefix, definitions, begun)
        base = self.terms.get(prefix)
        return meant if base is None or base.startswith("@") else base + suffix


def _too_deep() -> DataModelError:
    return DataModelError("the @context is nested too deeply; simplify it")


def _shortest_terms(iris: Mapping[str, str]) -> dict[str, str]:
    """Return the shortest term of each IRI, the lexicographically first of equals (as in JSON-LD)."""
    terms: dict[str, str] = {}
    for term, iri in sorted(iris.items(), key=lambda pair: (len(pair[0]), pair[0])):
        terms.setdefault(iri, term)
    return terms


@cache
def _core_terms() -> dict[str, str]:
    reading = _Reading(resolve)
    reading.take(CORE_URL)
    return {term: iri for term, iri in reading.terms.items() if iri is not None}
