"""How a decision of the coach is worded: by a template, or by a language model of others.

The decision is made before and stands: the model words it and never changes it. A text of a model is used
only if `fault_of` finds none: short, one line, no digit, no negation, a word for the decision in the
language that was asked for, and no word for another decision. Otherwise, and on any failure or after the
deadline, the template words it.

The request has the decision, its coarse reason and the language. It has no name, id, pseudonym, heart rate,
speed or time, so the operator of the model learns of nobody.
"""

import asyncio
import json
import re
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import urlsplit

import httpx

from handover.messages import Message, message
from handover_cases.machines.treadmill.coach import Advice, Decision, Reason

DEADLINE_S: Final = 4.0
MAX_ANSWER_BYTES: Final = 64 * 1024
MIN_LETTERS, MAX_LETTERS = 6, 160
LANGUAGES: Final = {"en": "English", "de": "German", "fi": "Finnish"}

_WORDS: Final[dict[Advice, dict[str, tuple[str, ...]]]] = {
    Advice.FASTER: {
        "en": ("fast", "quick", "speed up", "pick up", "brisk", "increase"),
        "de": ("schnell", "zügig", "flott", "tempo erhöh", "leg zu", "legen sie zu"),
        "fi": ("nopeam", "reippaam", "vauhtia lisää", "lisää vauhtia", "ripeäm"),
    },
    Advice.KEEP: {
        "en": ("keep", "hold", "maintain", "stay", "steady", "continue"),
        "de": ("halt", "bleib", "weiter so", "beibehalt", "gleichmäßig"),
        "fi": ("pidä", "pysy", "jatka", "säilytä", "tasais"),
    },
    Advice.SLOWER: {
        "en": ("slow", "ease", "easier", "reduc", "gently", "relax"),
        "de": ("langsam", "ruhiger", "tempo verringer", "gemächlich", "nimm tempo", "nehmen sie tempo"),
        "fi": ("hitaam", "hidasta", "hiljen", "rauhallisem", "kevenn"),
    },
}
"""Beginnings of words that say a decision."""
_NEGATIONS: Final[dict[str, re.Pattern[str]]] = {
    "en": re.compile(r"\b(not|no|never|without|stop|cannot)\b|n['’]t\b"),
    "de": re.compile(r"\b(nicht|nie|niemals|ohne|kein\w*|stopp?)\b"),
    "fi": re.compile(r"\b(ei|en|et|emme|ette|eivät|äl[äk]\w*|ilman|pysähdy\w*)\b"),
}
_MARKUP: Final = re.compile(r"[<>{}\[\]`*_#|\\]|https?:|www\.", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Words:
    """What the coach says. `source` is `template` or `model`; `problem` says why a model was not used."""

    text: str
    source: str
    problem: str = ""


def template(decision: Decision, number: int) -> Message:
    """Return the words of a template; `number` counts the decisions, so that they vary."""
    reason = decision.reason
    if reason is Reason.NO_SIGNAL:
        return message(
            "trainer.noSignal", "Slow down, please. Your heart rate is not read; check the sensor."
        )
    if reason is Reason.AT_LIMIT:
        return message("trainer.atLimit", "Keep this pace. The belt is at its highest speed for you.")
    if decision.advice is Advice.KEEP and decision.reason is not Reason.INSIDE:
        return message("trainer.keep.waiting", "Keep this pace. Your heart is still following it.")
    if decision.advice is Advice.FASTER:
        return (
            message("trainer.faster.first", "You can walk a little faster."),
            message("trainer.faster.second", "Good. Now take slightly quicker steps."),
            message("trainer.faster.third", "A bit faster, and you are in your zone."),
        )[number % 3]
    if decision.advice is Advice.SLOWER:
        return (
            message("trainer.slower.first", "Walk a little slower, please."),
            message("trainer.slower.second", "Ease off a bit and breathe calmly."),
            message("trainer.slower.third", "Slow down slightly; you are doing enough."),
        )[number % 3]
    return (
        message("trainer.keep.first", "Well done. Keep this pace."),
        message("trainer.keep.second", "This is your zone. Stay with it."),
        message("trainer.keep.third", "Steady steps; keep going like this."),
    )[number % 3]


def fault_of(text: str, advice: Advice, language: str) -> str | None:
    """Return why a text of a model cannot be used for a decision, None if it can."""
    if not MIN_LETTERS <= len(text) <= MAX_LETTERS:
        return f"the text has {len(text)} characters; {MIN_LETTERS} to {MAX_LETTERS} are allowed"
    if any(letter.isdigit() or letter.isnumeric() for letter in text):
        return "the text has a digit"
    if _MARKUP.search(text) or not text.isprintable():
        return "the text has markup, an address or a control character"
    return _contradiction(text.casefold(), advice, language)


def _contradiction(lower: str, advice: Advice, language: str) -> str | None:
    if _NEGATIONS[language].search(lower):
        return "the text has a negation"
    for other, words in _WORDS.items():
        is_said = any(re.search(rf"\b{re.escape(word)}", lower) for word in words[language])
        if other is advice and not is_said:
            return f'the text does not say "{advice}"'
        if other is not advice and is_said and not _is_excused(advice, other):
            return f'the text says "{other}"'
    return None


def _is_excused(advice: Advice, other: Advice) -> bool:
    """Return whether a word for another decision is usual: "keep going, a little faster" says faster."""
    return other is Advice.KEEP and advice is not Advice.KEEP


def request_of(decision: Decision, language: str, model: str) -> dict[str, Any]:
    """Return the body of the request: everything that the operator of the model learns."""
    task = {
        Advice.FASTER: "Ask the walker to walk a little faster.",
        Advice.KEEP: "Ask the walker to keep the present pace.",
        Advice.SLOWER: "Ask the walker to walk a little slower.",
    }[decision.advice]
    system = (
        "You word one spoken sentence of a friendly trainer beside a treadmill. Say exactly what you are "
        "asked to say, in at most fifteen words, without digits, negations, markup or medical statements."
    )
    return {
        "model": model,
        "messages": [
            {"role": "system", "content": system},
            {"role": "user", "content": f"{task} Language: {LANGUAGES[language]}."},
        ],
        "max_tokens": 60,
        "temperature": 0.7,
    }


class ModelWording:
    """Asks the chat completions of an OpenAI-compatible server at `url`, such as `https://host/v1`.

    Raises `ValueError` for a URL that would send without TLS to another machine.
    """

    def __init__(self, url: str, model: str, key: str = "", deadline_s: float = DEADLINE_S) -> None:
        parts = urlsplit(url)
        is_near = parts.hostname in {"127.0.0.1", "::1", "localhost"}
        if not parts.hostname or not (parts.scheme == "https" or (parts.scheme == "http" and is_near)):
            raise ValueError(
                f"the URL of the language model is {url!r}; it must begin with https://, or with http:// on "
                "this machine"
            )
        if not model:
            raise ValueError("the language model has no name; set HANDOVER_TRAINER_MODEL_NAME")
        self._url = url.rstrip("/") + "/chat/completions"
        self._model = model
        self._headers = {"Authorization": f"Bearer {key}"} if key else {}
        self._deadline_s = deadline_s
        # Without proxies of the environment: the request leaves as the setting says, or not at all.
        self._http = httpx.AsyncClient(follow_redirects=False, trust_env=False, timeout=deadline_s)

    async def word(self, decision: Decision, number: int, language: str) -> Words:
        """Return the words of the model, or those of the template with the problem. Never raises."""
        try:
            async with asyncio.timeout(self._deadline_s):
                text = await self._ask(decision, language)
        except TimeoutError:
            return Words(template(decision, number), "template", "no answer before the deadline")
        except (httpx.HTTPError, ValueError) as error:
            return Words(template(decision, number), "template", str(error)[:200] or type(error).__name__)
        fault = fault_of(text, decision.advice, language)
        return Words(text, "model") if fault is None else Words(template(decision, number), "template", fault)

    async def _ask(self, decision: Decision, language: str) -> str:
        body = request_of(decision, language, self._model)
        async with self._http.stream("POST", self._url, json=body, headers=self._headers) as answer:
            if answer.status_code != 200:
                raise ValueError(f"the server answered {answer.status_code}")
            content = bytearray()
            async for part in answer.aiter_bytes():
                content += part
                if len(content) > MAX_ANSWER_BYTES:
                    raise ValueError(f"the answer has more than {MAX_ANSWER_BYTES} bytes")
        return _text_in(bytes(content))

    async def close(self) -> None:
        """Close the connections."""
        await self._http.aclose()


def _text_in(content: bytes) -> str:
    """Return the text of an answer. Raises `ValueError` if it is none."""
    try:
        text = json.loads(content)["choices"][0]["message"]["content"]
    except (ValueError, KeyError, IndexError, TypeError, RecursionError) as error:
        raise ValueError("the answer is no chat completion") from error
    if not isinstance(text, str):
        raise ValueError("the answer has no text")  # noqa: TRY004 - the content is wrong, not our code
    return text.strip().strip('"“”„').strip()
