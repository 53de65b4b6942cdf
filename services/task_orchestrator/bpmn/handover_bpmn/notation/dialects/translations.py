"""Translations: the texts of a process for people of other languages, as `handover:translations` has them."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import orjson
from lxml import etree

from handover.messages import message
from handover_bpmn.notation.document import is_bpmn, local
from handover_bpmn.notation.faults import Findings

MAX_TRANSLATIONS = 2_000
MAX_TEXT = 2_000
"""Every page receives the translations of every definition."""

PLACEHOLDER = re.compile(r"([$#]\{[^}]*\})")
"""A `${…}` in a text."""

_LANGUAGE = re.compile(r"[a-z]{2,3}(?:-[A-Za-z0-9]{2,8})*", re.ASCII)


def read_translations(
    groups: Mapping[etree._Element, Sequence[etree._Element]], process: etree._Element, findings: Findings
) -> dict[str, dict[str, str]]:
    """Return the translations by language (BCP 47), then by the text of the file with single spaces.

    `groups` are the elements `handover:translations` with their `handover:translation`. Faults and warnings
    are reported at these elements.
    """
    if not groups:
        return {}
    texts = set(_texts(process.getroottree().getroot()))
    translations: dict[str, dict[str, str]] = {}
    for group, entries in groups.items():
        language = group.get("language") or ""
        if not _LANGUAGE.fullmatch(language):
            findings.fault(
                group,
                message(
                    "bpmn.wrong_language",
                    'language="{language}" is no language; write its code, such as de or pt-BR',
                    language=language[:64],
                ),
            )
            continue
        translated = translations.setdefault(language, {})
        for entry in entries:
            _read(entry, translated, texts, findings)
    if sum(map(len, translations.values())) > MAX_TRANSLATIONS:
        findings.fault(
            next(iter(groups)),
            message(
                "bpmn.too_many_translations",
                "a process has at most {limit} translations in all languages",
                limit=MAX_TRANSLATIONS,
            ),
        )
        return {}
    return translations


def _read(entry: etree._Element, translated: dict[str, str], texts: set[str], findings: Findings) -> None:
    source, translation = _plain(entry.get("source") or ""), _plain(entry.text or "")
    if not source or not translation:
        findings.fault(
            entry,
            message(
                "bpmn.empty_translation",
                "handover:translation has a text of the file as its source, and its translation as its text",
            ),
        )
    elif max(len(source), len(translation)) > MAX_TEXT:
        findings.fault(
            entry,
            message(
                "bpmn.long_translation", "a translated text has at most {limit} characters", limit=MAX_TEXT
            ),
        )
    elif translated.setdefault(source, translation) != translation:
        findings.fault(
            entry,
            message(
                "bpmn.translated_twice", '"{text}" has two translations in one language', text=source[:100]
            ),
        )
    elif unknown := set(PLACEHOLDER.findall(translation)) - set(PLACEHOLDER.findall(source)):
        findings.warn(
            entry,
            message(
                "bpmn.translation_placeholder",
                'the translation of "{text}" has {placeholder}, which the text does not have; '
                "it is shown as it is",
                text=source[:100],
                placeholder=min(unknown)[:100],
            ),
        )
    elif source not in texts:
        findings.warn(
            entry,
            message(
                "bpmn.translation_unused",
                '"{text}" is no text of this file; its translation is shown only if a deployed form has it',
                text=source[:100],
            ),
        )


def _texts(root: etree._Element) -> Iterator[str]:
    """Yield the texts of a file that people may read, with single spaces."""
    for element in root.iter("{*}*"):
        if local(element) == "translation":
            continue
        names = ("name",) if is_bpmn(element) else element.attrib
        for name in names:
            yield _plain(element.get(name) or "")
        text = _plain(element.text or "")
        yield text
        if text.startswith("{"):
            yield from _texts_of_form(text)


def _texts_of_form(text: str) -> Iterator[str]:
    try:
        yield from _strings(orjson.loads(text))
    except orjson.JSONDecodeError:  # no form
        return


def _strings(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield _plain(value)
    elif isinstance(value, Mapping):
        for member in value.values():
            yield from _strings(member)
    elif isinstance(value, list):
        for member in value:
            yield from _strings(member)


def _plain(text: str) -> str:
    return " ".join(text.split())
