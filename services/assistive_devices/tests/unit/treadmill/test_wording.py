"""A model of others words the advice and decides nothing; when it fails or lies, the template speaks."""

import itertools
import json
from collections.abc import AsyncIterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_cases.machines.treadmill.coach import Advice, Decision, Reason
from handover_cases.machines.treadmill.wording import (
    LANGUAGES,
    MAX_LETTERS,
    ModelWording,
    fault_of,
    request_of,
    template,
)
from services.assistive_devices.tests.unit.treadmill.completions import Completions, obedient, serving

FASTER = Decision(Advice.FASTER, Reason.BELOW, 30.0)
SLOWER = Decision(Advice.SLOWER, Reason.ABOVE, 60.0)
KEEP = Decision(Advice.KEEP, Reason.INSIDE, 90.0)


@pytest.fixture
async def server() -> AsyncIterator[Completions]:
    with serving(Completions(obedient)) as found:
        yield found


async def worded(
    server: Completions, decision: Decision, *, deadline_s: float = 30.0, language: str = "en"
) -> tuple[str, str, str]:
    wording = ModelWording(server.url, "small-model", "secret-key", deadline_s)
    try:
        words = await wording.word(decision, 0, language)
    finally:
        await wording.close()
    return words.text, words.source, words.problem


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("decision", [FASTER, SLOWER, KEEP])
async def test_a_model_words_every_decision_in_every_language(
    server: Completions, decision: Decision, language: str
) -> None:
    text, source, problem = await worded(server, decision, language=language)
    assert (source, problem) == ("model", "")
    assert text != template(decision, 0)
    assert server.paths == ["/v1/chat/completions"]
    assert server.headers[0]["Authorization"] == "Bearer secret-key"


async def test_a_request_has_nothing_but_advice_and_language(server: Completions) -> None:
    """For any person and any heart rate, equal advice makes equal requests."""
    seen: dict[tuple[Advice, str], set[str]] = {}
    for advice, reason, at_s, language in itertools.product(Advice, Reason, (0.0, 431.25), LANGUAGES):
        body = request_of(Decision(advice, reason, at_s), language, "small-model")
        seen.setdefault((advice, language), set()).add(json.dumps(body))
    assert {len(bodies) for bodies in seen.values()} == {1}
    await worded(server, FASTER)
    sent = json.dumps(server.bodies[0])
    assert sent in seen[Advice.FASTER, "en"]
    assert set(server.bodies[0]) == {"model", "messages", "max_tokens", "temperature"}
    assert not any(letter.isdigit() for letter in json.dumps(server.bodies[0]["messages"])), (
        "no figure at all"
    )
    assert {name.lower() for name in server.headers[0]} <= {
        *("host", "accept", "accept-encoding", "connection", "user-agent", "content-length", "content-type"),
        "authorization",
    }


async def test_a_hanging_model_is_left_at_the_deadline(server: Completions) -> None:
    server.hangs = True
    text, source, problem = await worded(server, SLOWER, deadline_s=0.3)
    assert (text, source) == (template(SLOWER, 0), "template")
    assert "deadline" in problem


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"status": 500}, "answered 500"),
        ({"status": 429}, "answered 429"),
        ({"status": 307, "location": "http://127.0.0.1:9/v1/chat/completions"}, "answered 307"),
        ({"raw": b"<html>busy</html>"}, "no chat completion"),
        ({"raw": b'{"choices": []}'}, "no chat completion"),
        ({"raw": b'{"choices": [{"message": {"content": null}}]}'}, "no text"),
        ({"raw": b"[" * 60_000}, "no chat completion"),
        ({"raw": b"x" * 70_000}, "more than 65536 bytes"),
    ],
)
async def test_a_failing_model_is_replaced_by_the_template(
    server: Completions, changes: dict[str, object], problem: str
) -> None:
    for name, value in changes.items():
        setattr(server, name, value)
    text, source, found = await worded(server, FASTER)
    assert (text, source) == (template(FASTER, 0), "template")
    assert problem in found


async def test_a_server_that_is_not_there_is_replaced_by_the_template(server: Completions) -> None:
    wording = ModelWording("http://127.0.0.1:1/v1", "m")
    words = await wording.word(KEEP, 1, "en")
    await wording.close()
    assert (words.text, words.source) == (template(KEEP, 1), "template")
    assert words.problem


@pytest.mark.parametrize(
    ("decision", "lie", "problem"),
    [
        (SLOWER, "Great, walk a little faster!", 'says "faster"'),
        (SLOWER, "Go slower, or rather faster.", 'says "faster"'),
        (SLOWER, "Do not slow down now!", "negation"),
        (SLOWER, "Keep going like this.", 'does not say "slower"'),
        (FASTER, "Walk slower, please.", 'does not say "faster"'),
        (FASTER, "Faster! Your heart beats only 61.", "digit"),
        (FASTER, "Faster! Your heart beats only ٦١.", "digit"),
        (FASTER, "Walk faster <b>now</b>", "markup"),
        (FASTER, "Walk faster, see https://example.org", "markup"),
        (KEEP, "You are resting, well done.", 'does not say "keep"'),
        (KEEP, "Keep it, but slower.", 'says "slower"'),
        (KEEP, "", "0 characters"),
        (KEEP, "Keep " + "on " * 60, "characters"),
    ],
)
async def test_a_lying_model_is_replaced_by_the_template(
    server: Completions, decision: Decision, lie: str, problem: str
) -> None:
    server.answer = lambda _: lie
    text, source, found = await worded(server, decision)
    assert (text, source) == (template(decision, 0), "template")
    assert problem in found


@pytest.mark.parametrize("language", LANGUAGES)
def test_contradictions_are_found_in_each_language(language: str) -> None:
    said = {
        "en": ("Walk faster now.", "Keep this pace.", "Walk slower now."),
        "de": ("Gehen Sie schneller.", "Bleiben Sie dabei.", "Gehen Sie langsamer."),
        "fi": ("Kävele nopeammin.", "Pidä tämä vauhti.", "Kävele hitaammin."),
    }[language]
    denied = {"en": "Never walk slower.", "de": "Gehen Sie nicht langsamer.", "fi": "Älä kävele hitaammin."}
    for text, advice in itertools.product(said, Advice):
        is_right = said.index(text) == list(Advice).index(advice)
        assert (fault_of(text, advice, language) is None) is is_right
    assert "negation" in (fault_of(denied[language], Advice.SLOWER, language) or "")


@given(st.text(max_size=200), st.sampled_from(Advice), st.sampled_from(sorted(LANGUAGES)))
def test_no_text_passes_that_is_long_or_has_figures(text: str, advice: Advice, language: str) -> None:
    if fault_of(text, advice, language) is None:
        assert len(text) <= MAX_LETTERS
        assert not any(letter.isnumeric() for letter in text)
        assert text.isprintable()


@pytest.mark.parametrize(
    ("url", "model", "problem"),
    [
        ("http://models.example.org/v1", "m", "must begin with https://"),
        ("ftp://127.0.0.1/v1", "m", "must begin with https://"),
        ("https://models.example.org/v1", "", "HANDOVER_TRAINER_MODEL_NAME"),
    ],
)
def test_a_model_that_cannot_be_asked_safely_is_refused(url: str, model: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        ModelWording(url, model)


def test_the_templates_pass_their_own_check_and_vary() -> None:
    for advice, reason in ((Advice.FASTER, Reason.BELOW), (Advice.SLOWER, Reason.ABOVE)):
        texts = {template(Decision(advice, reason, 0.0), number) for number in range(3)}
        assert len(texts) == 3
        assert [fault_of(text, advice, "en") for text in texts] == [None] * 3
    assert "sensor" in template(Decision(Advice.SLOWER, Reason.NO_SIGNAL, 0.0), 0)
    assert "highest speed" in template(Decision(Advice.KEEP, Reason.AT_LIMIT, 0.0), 0)
