"""Headers: media types and preferences (clauses 6.3.4 to 6.3.6, 6.3.21)."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.model.negotiation import (
    PLAIN,
    WITH_GEO_JSON,
    accepted,
    preferences,
    preferred_version,
    version_of,
)

J, LD, GEO = "application/json", "application/ld+json", "application/geo+json"


@pytest.mark.parametrize(
    ("accept", "offered", "chosen"),
    [
        (f"{LD}, {J}", PLAIN, J),
        (f"{GEO}, {J}", WITH_GEO_JSON, J),
        (f"{J};q=0.1, {LD};q=0.9", PLAIN, LD),
        (LD, PLAIN, LD),
        (GEO, WITH_GEO_JSON, GEO),
        (GEO, PLAIN, None),
        (f"{GEO};q=0.9, {LD};q=0.1", PLAIN, LD),
        ("*/*", PLAIN, J),
        ("application/*", WITH_GEO_JSON, J),
        (f"{J};q=0, */*", PLAIN, LD),
        (f"{J};q=0, {LD}", PLAIN, LD),
        (f"*/*;q=0.9, {LD};q=0.8", PLAIN, J),
        (f"{LD};q=notanumber", PLAIN, LD),
        (f"{J};q=0", PLAIN, None),
        ("*/*;q=0", PLAIN, None),
        ("text/html", PLAIN, None),
        (f"text/html, {LD}; charset=utf-8; q=0.2, */*;q=0.1", PLAIN, LD),
        (f"APPLICATION/LD+JSON , {J} ; q=0.5", PLAIN, LD),
        ("", PLAIN, None),
    ],
)
def test_the_best_liked_media_type_is_answered(
    accept: str, offered: tuple[str, ...], chosen: str | None
) -> None:
    assert accepted(accept.encode(), offered) == chosen


@given(st.binary(max_size=80))
def test_any_header_can_be_read(header: bytes) -> None:
    assert accepted(header, WITH_GEO_JSON) in {J, LD, GEO, None}
    preferences(header)
    with suppress(Problem):
        preferred_version(header)


def test_preferences_are_found_among_others() -> None:
    assert preferences(b'respond-async, body=json; x=1, ngsi-ld="1.6"') == {
        "respond-async": "",
        "body": "json",
        "ngsi-ld": "1.6",
    }
    assert preferred_version(b"body=json, NGSI-LD=1.6.1") == (1, 6)
    assert preferred_version(b"body=json") is None


@pytest.mark.parametrize("text", ["", "1", "one.six", "1.6.1.1", "1.-6", "9999.1"])
def test_an_invalid_version_is_refused(text: str) -> None:
    assert version_of(text) is None
    with pytest.raises(Problem, match=r"1\.6"):
        preferred_version(f"ngsi-ld={text}".encode())
