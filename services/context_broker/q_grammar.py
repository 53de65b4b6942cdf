"""The query language `q`, read into a tree: who asks for Tasks in progress writes `status=="inProgress"`.

Grammar of ETSI GS CIM 009, clause 4.9. `;` is and, `|` is or; and binds tighter. The tree holds short names;
`q_match` gives them a meaning.
"""

import re
from dataclasses import dataclass
from enum import Enum
from typing import Final, NoReturn

import orjson

from handover.errors import Problem
from services.context_broker.patterns import pattern
from services.context_broker.problems import bad_request_data
from services.context_broker.words import moment, shown

LONGEST: Final = 20_000
"""Characters of a query that are read."""
DEEPEST: Final = 50
"""Brackets within brackets that are read."""


class Kind(Enum):
    """What a literal is, and so what it can be compared with."""

    TEXT = "text"
    NUMBER = "number"
    TRUTH = "truth"
    TIME = "time"
    URI = "uri"


@dataclass(frozen=True, slots=True)
class Literal:
    """A value in a query; a time is in seconds since 1970 for dates, or its text for times of day."""

    kind: Kind
    value: str | float | bool


@dataclass(frozen=True, slots=True)
class Span:
    """All values from `low` to `high`, both included."""

    low: Literal
    high: Literal


@dataclass(frozen=True, slots=True)
class Path:
    """Where a value is: `names` lead to an attribute (of an attribute …), `trail` into its value."""

    names: tuple[str, ...]
    trail: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Exists:
    """There is such an attribute."""

    path: Path


@dataclass(frozen=True, slots=True)
class Compare:
    """The value stands in relation `operator` to one of `values`."""

    path: Path
    operator: str
    values: tuple[Literal | Span, ...]


@dataclass(frozen=True, slots=True)
class Matches:
    """The text fits (or, negated, does not fit) the pattern."""

    path: Path
    pattern: re.Pattern[str]
    negated: bool


@dataclass(frozen=True, slots=True)
class And:
    """All terms hold."""

    terms: tuple["Term", ...]


@dataclass(frozen=True, slots=True)
class Or:
    """At least one term holds."""

    terms: tuple["Term", ...]


Term = Exists | Compare | Matches | And | Or

_OPERATOR = re.compile(r"!~=|~=|==|!=|>=|<=|>|<")
_NAME = re.compile(r"[A-Za-z_@][A-Za-z0-9_\-:@]*")
_IRI = re.compile(r"(?:https?://|urn:)[^\s\[\]()=!<>~;|\"]+")
_TRAIL = re.compile(r"[^\]\[\"]+")
_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"', re.DOTALL)
_BARE = re.compile(r"[^;|(),\"\s]+?(?=\.\.|[;|(),\"\s]|$)")
_NUMBER = re.compile(r"-?(?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][+-]?\d+)?")
_TIME_OF_DAY = re.compile(r"\d{2}:\d{2}:\d{2}(?:[.,]\d+)?Z?")
_URI = re.compile(r"[A-Za-z][A-Za-z0-9+.\-]*:\S+")


def parse(text: str) -> Term:
    """Return the tree of a query; raise a problem that says where and why it cannot be read."""
    if len(text) > LONGEST:
        raise bad_request_data(f"q has {len(text)} characters; {LONGEST} are allowed")
    return _Parser(text).whole()


class _Parser:
    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0

    def whole(self) -> Term:
        term = self.either(0)
        if self.at < len(self.text):
            self.fail("expected ; or | or the end")
        return term

    def either(self, depth: int) -> Term:
        terms = [self.all_of(depth)]
        while self.take("|"):
            terms.append(self.all_of(depth))
        return terms[0] if len(terms) == 1 else Or(tuple(terms))

    def all_of(self, depth: int) -> Term:
        terms = [self.one(depth)]
        while self.take(";"):
            terms.append(self.one(depth))
        return terms[0] if len(terms) == 1 else And(tuple(terms))

    def one(self, depth: int) -> Term:
        if not self.take("("):
            return self.condition()
        if depth >= DEEPEST:
            self.fail(f"brackets are nested deeper than {DEEPEST}")
        term = self.either(depth + 1)
        if not self.take(")"):
            self.fail("expected )")
        return term

    def condition(self) -> Term:
        path = self.path()
        operator = self.match(_OPERATOR)
        if operator is None:
            return Exists(path)
        if operator in {"~=", "!~="}:
            return Matches(path, self.pattern(), operator == "!~=")
        values = self.values()
        if operator not in {"==", "!="} and (len(values) > 1 or isinstance(values[0], Span)):
            self.fail(f"{operator} takes one value; lists and ranges go with == and !=")
        return Compare(path, operator, values)

    def path(self) -> Path:
        iri = self.match(_IRI)
        if iri is not None:
            names = [iri]
        else:
            names = [self.name()]
            while self.take("."):
                names.append(self.name())
        trail: list[str] = []
        if self.take("["):
            trail = self.trail()
        return Path(tuple(names), tuple(trail))

    def trail(self) -> list[str]:
        if quoted := self.match(_QUOTED):
            steps = [self.unquoted(quoted)]
        else:
            steps = (self.match(_TRAIL) or "").split(".")
        if not all(steps):
            self.fail("expected a path such as [a.b]")
        if not self.take("]"):
            self.fail("expected ]")
        return steps

    def name(self) -> str:
        return self.match(_NAME) or self.fail("expected the name of an attribute")

    def values(self) -> tuple[Literal | Span, ...]:
        values = [self.value_or_span()]
        while self.take(","):
            values.append(self.value_or_span())
        return tuple(values)

    def value_or_span(self) -> Literal | Span:
        low = self.value()
        if not self.text.startswith("..", self.at):
            return low
        self.at += 2
        high = self.value()
        if low.kind is not high.kind or type(low.value) is not type(high.value) or low.kind is Kind.TRUTH:
            self.fail("a range has two numbers, two texts or two times")
        return Span(low, high)

    def value(self) -> Literal:
        quoted = self.match(_QUOTED)
        if quoted is not None:
            return Literal(Kind.TEXT, self.unquoted(quoted))
        start = self.at
        bare = self.match(_BARE) or self.fail('expected a value: a number, true, a date, a URI or "text"')
        literal = _literal(bare)
        if literal is None:
            self.at = start
            self.fail(f'{shown(bare)} is no number, date or URI; text stands in double quotes: "{bare[:40]}"')
        return literal

    def pattern(self) -> re.Pattern[str]:
        quoted = self.match(_QUOTED)
        text = self.unquoted(quoted) if quoted is not None else self.bare_pattern()
        try:
            return pattern(text)
        except Problem as problem:
            self.fail(problem.detail)

    def bare_pattern(self) -> str:
        """Take an unquoted pattern: up to the ; | or ) that is not inside its own brackets."""
        start, depth = self.at, 0
        while self.at < len(self.text):
            sign = self.text[self.at]
            if sign == "\\":
                self.at += 1
            elif sign in "([":
                depth += 1
            elif (sign in ";|" and depth == 0) or (sign == ")" and depth == 0):
                break
            elif sign in ")]":
                depth -= 1
            self.at += 1
        self.at = min(self.at, len(self.text))
        return self.text[start : self.at] or self.fail("expected a pattern")

    def unquoted(self, quoted: str) -> str:
        try:
            text: str = orjson.loads(quoted)
        except (orjson.JSONDecodeError, UnicodeEncodeError):
            # A pattern such as "\d+" is no JSON string: there a backslash is a backslash.
            text = quoted[1:-1].replace('\\"', '"')
        return text

    def take(self, sign: str) -> bool:
        if self.text.startswith(sign, self.at):
            self.at += len(sign)
            return True
        return False

    def match(self, expected: re.Pattern[str]) -> str | None:
        found = expected.match(self.text, self.at)
        if found is None:
            return None
        self.at = found.end()
        return found.group()

    def fail(self, why: str) -> NoReturn:
        raise bad_request_data(f"q cannot be read at character {self.at + 1} of {shown(self.text)}: {why}")


def _literal(bare: str) -> Literal | None:
    if bare in {"true", "false"}:
        return Literal(Kind.TRUTH, bare == "true")
    if _NUMBER.fullmatch(bare):
        return Literal(
            Kind.NUMBER, float(bare) if len(bare) > 15 or not bare.lstrip("-").isdigit() else int(bare)
        )
    if _TIME_OF_DAY.fullmatch(bare):
        return Literal(Kind.TIME, bare)
    if bare[:1].isdigit() and "-" in bare:
        seconds = moment(bare)
        return None if seconds is None else Literal(Kind.TIME, seconds)
    if _URI.fullmatch(bare):
        return Literal(Kind.URI, bare)
    return None
