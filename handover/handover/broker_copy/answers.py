"""Answers of a broker to the copy: JSON, pages, counts, terms of an @context, refusals of a batch."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final
from urllib.parse import parse_qsl, urlsplit

import orjson

from handover.broker import BrokerError
from handover.broker_copy.entity_form import Json
from handover.errors import HandoverError
from handover.network.http_client import HttpResponse
from handover_datamodels.contexts import ContextNotAvailable, TermMap, term_map

_LINK: Final = re.compile(r"<([^>]*)>([^<]*)")
_NEXT: Final = re.compile(r"\brel=\"?next\b")


def refusals_in(answer: HttpResponse, batch: Sequence[Json]) -> Iterator[tuple[str, str]]:
    """Yield the ids and reasons of a partial success (207)."""
    document = as_object(answer)
    unnamed: list[str] = []
    for error in document.get("errors") or ():
        problem = error.get("error") if isinstance(error, Mapping) else error
        texts = (
            [str(problem[name]) for name in ("title", "detail") if problem.get(name)]
            if isinstance(problem, Mapping)
            else [str(problem)]
        )
        reason = ": ".join(texts) or "refused without a reason"
        entity_id = error.get("entityId") if isinstance(error, Mapping) else None
        if isinstance(entity_id, str):
            yield entity_id, reason
        else:
            unnamed.append(reason)
    if unnamed:
        done = set(map(str, document.get("success") or ()))
        for entity in batch:
            if entity["id"] not in done:
                yield entity["id"], "; ".join(unnamed)


def reason_of(error: BrokerError) -> str:
    """Return why a broker refused something."""
    return f"{error.status} {error}"


def as_object(answer: HttpResponse) -> Json:
    """Return the JSON object of an answer. Raises `HandoverError` if it is none."""
    document = as_json(answer)
    if not isinstance(document, dict):
        raise HandoverError(f"the broker answers {document!r:.200} in place of a JSON object")
    return document


def as_list(answer: HttpResponse) -> list[Json]:
    """Return the JSON objects of an answer. Raises `HandoverError`."""
    document = as_json(answer)
    if not isinstance(document, list) or not all(isinstance(part, dict) for part in document):
        raise HandoverError(f"the broker answers {document!r:.200} in place of a list of JSON objects")
    return document


def as_json(answer: HttpResponse) -> Any:
    """Return the JSON document of an answer. Raises `HandoverError` if it is none."""
    try:
        return orjson.loads(answer.body)
    except orjson.JSONDecodeError:
        text = answer.body[:200].decode(errors="replace")
        raise HandoverError(
            f"the broker answers {answer.status} with {text!r}, which is not JSON; is the address that of an "
            "NGSI-LD broker, and does it need credentials?"
        ) from None


def terms_of(document: Mapping[str, Any], url: str) -> TermMap:
    """Return the terms of the @context in an answer."""
    context = document.get("@context")
    try:
        return term_map(context)
    except ContextNotAvailable as error:
        raise HandoverError(
            f"the broker {url} answers with the names of the @context {error.url}, though none was asked "
            "for; set it to use the core @context by default while it is copied"
        ) from None


def count_in(answer: HttpResponse) -> int | None:
    """Return the count of all results that an answer states; None if it does not."""
    total = answer.headers.get("ngsild-results-count", "")
    return int(total) if total.isdecimal() else None


def next_page(link: str) -> Json | None:
    """Return the parameters of the next page that a Link header names."""
    for match in _LINK.finditer(link):
        if _NEXT.search(match[2]):
            return dict(parse_qsl(urlsplit(match[1]).query, keep_blank_values=True))
    return None
