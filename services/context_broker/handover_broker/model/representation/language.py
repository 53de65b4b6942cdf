"""Language preferences, and the best text of a LanguageProperty (clause 4.15).

Preferences are those of RFC 3282 (`fr-CH,fr;q=0.9,*;q=0.5`). A tag is looked up as in RFC 4647: as it is,
then shortened, then with any extension.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

from handover_broker.model.entity import Instance
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import shown

LONGEST: Final = 1024
ANY: Final = "*"
WITHOUT_TAG: Final = "@none"
"""The key of a text without a language."""


@lru_cache(maxsize=1024)
def preferences(languages: str) -> tuple[str, ...]:
    """Return the language ranges of `lang`, best first, in lower case; raise a problem (400) for invalid
    ones."""
    if len(languages) > LONGEST:
        raise bad_request_data(f"lang has {len(languages)} characters; {LONGEST} are read")
    weighed: list[tuple[float, str]] = []
    for part in languages.split(","):
        tag, *options = (piece.strip().lower() for piece in part.split(";"))
        if tag != ANY and not (
            tag and all(subtag.isascii() and subtag.isalnum() for subtag in tag.split("-"))
        ):
            raise bad_request_data(
                f"lang={shown(languages)} has no language tag such as en or fr-CH in {shown(part)}"
            )
        weight = _weight(options, languages)
        if weight > 0:
            weighed.append((-weight, tag))
    return tuple(tag for _, tag in sorted(weighed, key=lambda weighed_tag: weighed_tag[0]))


def _weight(options: list[str], languages: str) -> float:
    for option in options:
        name, _, value = option.partition("=")
        try:
            weight = float(value) if name.strip() == "q" else -1.0
        except ValueError:
            weight = -1.0
        if not 0 <= weight <= 1:
            raise bad_request_data(
                f"lang={shown(languages)}: after a tag only a weight such as ;q=0.5 is read"
            )
        return weight
    return 1.0


def best_tag(wordings: Mapping[str, Any], wanted: tuple[str, ...]) -> str:
    """Return the key of the text that matches `wanted` best; any if none matches (there is at least one)."""
    tags = {tag.lower(): tag for tag in wordings}
    for language in wanted:
        if language == ANY:
            break
        if (best := _found(tags, language)) is not None:
            return best
    return WITHOUT_TAG if WITHOUT_TAG in wordings else next(iter(wordings))


def _found(tags: Mapping[str, str], language: str) -> str | None:
    shorter = language
    while shorter:
        if shorter in tags:
            return tags[shorter]
        shorter = shorter.rpartition("-")[0]
    return next((tag for lower, tag in tags.items() if lower.startswith(language + "-")), None)


def in_language(instance: Instance, wanted: tuple[str, ...]) -> Instance:
    """Return a LanguageProperty, also of sub-attributes, as a Property in one language."""
    result: Instance = {}
    for member, value in instance.items():
        if ":" in member:
            result[member] = [in_language(part, wanted) for part in value]
        elif member == "languageMap" and instance["type"] == "LanguageProperty" and value:
            tag = best_tag(value, wanted)
            result["type"], result["value"], result["lang"] = "Property", value[tag], tag
        elif member != "valueType" or instance["type"] != "LanguageProperty":
            result[member] = value
    return result
