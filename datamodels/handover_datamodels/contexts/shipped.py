"""The shipped contexts by their public URLs.

The files are our own: they define the terms of our vocabulary and of the NGSI-LD core with the IRIs of the
published contexts. Those that other brokers read are plain JSON-LD 1.0, without `@version` and without
nested contexts: some brokers refuse anything else.

The versions of the core context differ: 1.3 renamed terms (`start` to `startAt`) and gave others the IRI of
another vocabulary (`description`), and later versions removed some again. Brokers that cannot fetch the
version that they are set to may use the terms of 1.0. So a term of ours has the same IRI and type in every
version, except `CORE_EXCEPTIONS`. `ngsi-ld-core-versions.json` has the definitions of each term by the
versions that have it; `ngsi-ld-core.jsonld` is what our own broker uses.
"""

import json
import re
from copy import deepcopy
from functools import cache
from importlib.resources import files
from typing import Any, Final

HANDOVER_URL: Final = "https://w3id.org/handover/context.jsonld"
SMART_DATA_MODELS_URL: Final = "https://smartdatamodels.org/context.jsonld"
SHOP4CF_URL: Final = "https://raw.githubusercontent.com/shop4cf/data-models/master/docs/shop4cfcontext.jsonld"
CORE_URL: Final = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context.jsonld"

_FILES: Final = {
    HANDOVER_URL: "handover.jsonld",
    SMART_DATA_MODELS_URL: "smartdatamodels.jsonld",
    SHOP4CF_URL: "shop4cf.jsonld",
    CORE_URL: "ngsi-ld-core.jsonld",
}
_ANY_CORE = re.compile(
    r"https?://(uri\.etsi\.org/ngsi-ld/v1/ngsi-ld-core-context(-v1\.(?P<minor>[0-9]{1,2})(\.[0-9])?)?\.jsonld"
    r"|forge\.etsi\.org/(gitlab|rep)/NGSI-LD/NGSI-LD/(-/)?raw/[\w.\-]+/coreContext/ngsi-ld-core-context\.jsonld)"
)
"""The URLs of the core context 1.0 to 1.9, and of drafts of the first ones."""

CORE_MINORS: Final = range(10)
"""The versions of the core context, 1.0 to 1.9. The first three have the same terms."""
CORE_EXCEPTIONS: Final = frozenset({"description", "name"})
"""Terms of ours to which the core contexts 1.0 to 1.2 give another IRI, without a type.

`description` has two IRIs in the core contexts themselves; `name` is in every data model that we share. A
broker with such a core context reads and writes both under its own IRIs.
"""
_FIRST_WITH_GEOJSON: Final = 3
_FIRST_PROTECTED: Final = 8


def resolve(url: str) -> dict[str, Any] | None:
    """Return the JSON-LD document `{"@context": …}` of `url` if it is shipped, None if it is not.

    A core context of a version has the terms of that version; one without a version, or of an unknown one,
    has those of our broker. The document is a copy.
    """
    if (name := _FILES.get(url)) is not None:
        return deepcopy(_document(name))
    core = _ANY_CORE.fullmatch(url)
    if core is None:
        return None
    minor = int(core["minor"] or -1)
    return deepcopy(_core_document(minor) if minor in CORE_MINORS else _document(_FILES[CORE_URL]))


def core_terms(minor: int) -> dict[str, Any]:
    """Return the definitions of the terms of the core context 1.`minor`."""
    terms: dict[str, Any] = {}
    for term, by_versions in _document("ngsi-ld-core-versions.json").items():
        for versions, definition in by_versions.items():
            first, _, last = versions.partition("-")
            if _minor(first) <= minor <= _minor(last or first):
                terms[term] = definition
    return terms


def is_core(url: str) -> bool:
    """Return whether `url` is the core context of any version."""
    return _ANY_CORE.fullmatch(url) is not None


def handover_context() -> dict[str, Any]:
    """Return our own context, as the document `{"@context": …}` that is served at /context.jsonld."""
    return deepcopy(_document(_FILES[HANDOVER_URL]))


@cache
def _document(name: str) -> dict[str, Any]:
    text = files("handover_datamodels.contexts").joinpath(name).read_text(encoding="utf-8")
    document: dict[str, Any] = json.loads(text)
    return document


@cache
def _core_document(minor: int) -> dict[str, Any]:
    keywords: dict[str, Any] = {"@version": 1.1, "@protected": True} if minor >= _FIRST_PROTECTED else {}
    geojson = {"geojson": "https://purl.org/geojson/vocab#"} if minor >= _FIRST_WITH_GEOJSON else {}
    names = {"id": "@id", "type": "@type", "ngsi-ld": "https://uri.etsi.org/ngsi-ld/", **geojson}
    vocab = {"@vocab": "https://uri.etsi.org/ngsi-ld/default-context/"}
    return {"@context": {**keywords, **vocab, **names, **core_terms(minor)}}


def _minor(version: str) -> int:
    return int(version.removeprefix("1."))
