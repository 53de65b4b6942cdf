"""The shipped contexts by their public URLs.

The files are our own: they define the terms of our vocabulary and of the NGSI-LD core with the IRIs of the
published contexts.
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
    r"https?://(uri\.etsi\.org/ngsi-ld/v1/ngsi-ld-core-context(-v1\.[0-9]{1,2}(\.[0-9])?)?\.jsonld"
    r"|forge\.etsi\.org/(gitlab|rep)/NGSI-LD/NGSI-LD/(-/)?raw/[\w.\-]+/coreContext/ngsi-ld-core-context\.jsonld)"
)
"""The URLs of the core context 1.0 to 1.9, and of drafts of the first ones."""


def resolve(url: str) -> dict[str, Any] | None:
    """Return the JSON-LD document `{"@context": …}` of `url` if it is shipped, None if it is not.

    All versions of the core context return the same terms, since later versions only add terms. The
    document is a copy.
    """
    name = _FILES.get(CORE_URL if is_core(url) else url)
    return None if name is None else deepcopy(_document(name))


def is_core(url: str) -> bool:
    """Return whether `url` is the core context of any version."""
    return _ANY_CORE.fullmatch(url) is not None


def handover_context() -> dict[str, Any]:
    """Return our own context, as the document `{"@context": …}` that is served at /context.jsonld."""
    return deepcopy(_document(_FILES[HANDOVER_URL]))


@cache
def _document(name: str) -> dict[str, Any]:
    text = files("datamodels.contexts").joinpath(name).read_text(encoding="utf-8")
    document: dict[str, Any] = json.loads(text)
    return document
