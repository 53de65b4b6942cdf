"""Wording: what participants read, in their language; kept in files so that it can be checked and corrected.

The statements of SUS in English are those published. German and Finnish are our own careful translations, not
validated ones; each says so in its `source`, which stands in the report as well.
"""

import hashlib
from functools import cache
from importlib.resources import files
from typing import Any

import orjson

from handover_study.model.protocol import Language


@cache
def wording(language: Language) -> dict[str, Any]:
    """Return all that is read in `language`."""
    file = files("handover_study").joinpath(f"wording/{language}.json")
    read: dict[str, Any] = orjson.loads(file.read_bytes())
    return read


@cache
def consent_version(language: Language) -> str:
    """Return the version of the text of consent, another for every change of it."""
    text = orjson.dumps(wording(language)["consent"], option=orjson.OPT_SORT_KEYS)
    return f"{language}-{hashlib.sha256(text).hexdigest()[:12]}"
