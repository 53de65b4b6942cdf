"""The order of strings: by base characters first, then by accents, then by case.

An approximation of the root collation of ICU (clause 4.23.1 of ETSI GS CIM 009), with the differences of a
few languages. `collation` is a tag of RFC 6067 such as `und`, `de-u-co-phonebk` or `und-u-ks-level1-kn`.
"""

import re
import unicodedata
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final

from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import shown

Key = Callable[[str], Any]
"""Returns the sort key of a string."""

_MAX_TAG_LENGTH: Final = 100
_REPLACEMENTS: Final = {
    "æ": "ae", "œ": "oe", "ø": "o", "đ": "d", "ð": "d", "ł": "l", "ħ": "h", "þ": "th", "ı": "i",
}  # fmt: skip
"""Characters that do not decompose into a base character and an accent, and their replacements."""
_AFTER_Z: Final = "zz"
_AT_HOME: Final[dict[str, dict[str, str]]] = {
    "da": {"æ": "a", "ø": "b", "å": "c"},
    "et": {"õ": "a", "ä": "b", "ö": "c", "ü": "d"},
    "fi": {"å": "a", "ä": "b", "ö": "c"},
    "is": {"æ": "a", "ö": "b", "å": "c"},
    "nb": {"æ": "a", "ø": "b", "å": "c"},
    "nn": {"æ": "a", "ø": "b", "å": "c"},
    "no": {"æ": "a", "ø": "b", "å": "c"},
    "sv": {"å": "a", "ä": "b", "ö": "c"},
}
"""Languages with characters of their own after z, and the order of these."""
_AS_ROOT: Final = frozenset({"und", "de", "en", "fr", "ga", "id", "it", "ms", "nl", "pt", "root", "sw"})
"""Languages that use the root collation."""
_PHONE_BOOK: Final = {"ä": "ae", "ö": "oe", "ü": "ue"}
_STRENGTHS: Final = {"level1": 1, "level2": 2, "level3": 3, "level4": 3, "identic": 4}
_LOW: Final = {ord(sign): place for place, sign in enumerate("\t\n _-,;:!?.'\"()[]{}@*/\\&#%`^+<=>|~$", 1)}
"""Spaces and punctuation come before digits, digits before other characters."""
_DIGITS: Final = re.compile(r"\d+")


def collation(tag: str | None) -> Key:
    """Return the sort key function of a collation, None for the root collation.

    Raises a problem (400) with the available ones for an unknown collation.
    """
    return _collation("und" if tag is None else tag.lower())


@lru_cache(maxsize=16)
def _collation(tag: str) -> Key:
    language, _, extension = tag.partition("-u-")
    options = _options(extension) if len(tag) <= _MAX_TAG_LENGTH else None
    language = language.partition("-")[0]
    if options is None or not (language in _AS_ROOT or language in _AT_HOME):
        raise _unknown(tag)
    own = dict(_AT_HOME.get(language, {}))
    replacements = _REPLACEMENTS
    if options.pop("co", "standard") == "phonebk":
        if language != "de":
            raise _unknown(tag)
        replacements = {**_REPLACEMENTS, **_PHONE_BOOK}
    strength = _STRENGTHS[options.pop("ks", "level3")]
    is_numeric = options.pop("kn", "false") in {"true", ""}
    upper_first = options.pop("kf", "lower") == "upper"
    if options:
        raise _unknown(tag)

    @lru_cache(maxsize=4096)
    def key(text: str) -> Any:
        composed = unicodedata.normalize("NFC", text)
        base = _without_accents(composed.casefold(), own, replacements)
        if is_numeric:
            base = _DIGITS.sub(lambda match: f"{len(match[0].lstrip('0')):05}{match[0].lstrip('0')}", base)
        primary = base.translate(_LOW)
        if strength == 1:
            return (primary,)
        accents = unicodedata.normalize("NFD", composed.casefold())
        if strength == 2:
            return primary, accents
        case = composed if upper_first else composed.swapcase()
        return primary, accents, case

    return key


def _options(extension: str) -> dict[str, str] | None:
    """Return the options of a tag by their keys; None when one is unknown."""
    names = {"co": {"phonebk", "standard"}, "ks": set(_STRENGTHS), "kn": {"true", "false", ""},
             "kf": {"upper", "lower", "false"}}  # fmt: skip
    options: dict[str, str] = {}
    name = ""
    for part in extension.split("-") if extension else ():
        if part in names:
            name = part
            options[name] = ""
        elif name and not options[name] and part in names[name]:
            options[name] = part
        else:
            return None
    return options if all(value in names[name] for name, value in options.items()) else None


def _without_accents(text: str, own: dict[str, str], replacements: dict[str, str]) -> str:
    """Return the text without accents; characters of the language's own are put after z."""
    if text.isascii():
        return text
    parts: list[str] = []
    for sign in text:
        if sign in own:
            parts.append(_AFTER_Z + own[sign])
        elif sign in replacements:
            parts.append(replacements[sign])
        else:
            parts.append(
                "".join(c for c in unicodedata.normalize("NFD", sign) if not unicodedata.combining(c))
            )
    return "".join(parts)


def _unknown(tag: str) -> Exception:
    return bad_request_data(
        f"the collation {shown(tag)} is unknown; use one of {', '.join(sorted(_AS_ROOT | set(_AT_HOME)))}, "
        "with -u-co-phonebk for de, and -u-ks-level1, -kn and -kf-upper for all; or leave it out"
    )
