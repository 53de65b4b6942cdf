"""Parser of `q` filters: for example, Tasks in progress are `status=="inProgress"`.

Grammar of ETSI GS CIM 009, clause 4.9. `;` is and, `|` is or; and binds tighter. `sensor{humidity}` is the
humidity of the entity that the relationship `sensor` links to. The tree contains short names; `q_match`
expands them.
"""

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Final, NoReturn
from urllib.parse import unquote

import orjson

from handover.errors import Problem
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import moment, shown
from handover_broker.query.patterns import Pattern, pattern

LONGEST: Final = 20_000
"""Maximum length of a query."""
DEEPEST: Final = 50
"""Maximum nesting of brackets, and of links."""


class LiteralKind(Enum):
    """The kind of a literal, which determines what it is compared with."""

    TEXT = "text"
    NUMBER = "number"
    TRUTH = "truth"
    TIME = "time"
    URI = "uri"
    TERM = "term"
    """A term of the @context (expandValues)."""


@dataclass(frozen=True, slots=True)
class Literal:
    """A literal; a time is in seconds since 1970 for dates, or its text for times of day."""

    kind: LiteralKind
    value: str | float | bool


@dataclass(frozen=True, slots=True)
class Span:
    """All values from `low` to `high`, both included."""

    low: Literal
    high: Literal


@dataclass(frozen=True, slots=True)
class Path:
    """The location of a value: `names` are an attribute and its sub-attributes, `trail` a path in the value.

    With a `link` they name a relationship, and the path continues in the linked entities.
    """

    names: tuple[str, ...]
    trail: tuple[str, ...] = ()
    link: "LinkPath | None" = None

    @property
    def hops(self) -> int:
        """Return how many relationships are followed."""
        return 0 if self.link is None else 1 + self.link.path.hops


@dataclass(frozen=True, slots=True)
class LinkPath:
    """The rest of a path in a linked entity of any of `types` (short names); without types in any entity."""

    types: tuple[str, ...]
    path: Path


@dataclass(frozen=True, slots=True)
class Exists:
    """The attribute exists."""

    path: Path


@dataclass(frozen=True, slots=True)
class Compare:
    """The value has the relation `operator` to one of `values`."""

    path: Path
    operator: str
    values: tuple[Literal | Span, ...]


@dataclass(frozen=True, slots=True)
class Matches:
    """The text matches (or, negated, does not match) the pattern."""

    path: Path
    pattern: Pattern
    negated: bool


@dataclass(frozen=True, slots=True)
class And:
    """All terms are true."""

    terms: tuple["Term", ...]


@dataclass(frozen=True, slots=True)
class Or:
    """At least one term is true."""

    terms: tuple["Term", ...]


Term = Exists | Compare | Matches | And | Or

_OPERATOR = re.compile(r"!~=|~=|==|!=|>=|<=|>|<")
_NAME = re.compile(r"(?:[^\W\d]|@)[\w\-:@]*")
_IRI = re.compile(r"(?:https?://|urn:)[^\s\[\]{}()=!<>~;|\"]+")
_TRAIL = re.compile(r"[^\]\[\"]+")
_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"', re.DOTALL)
_BARE = re.compile(r"[^;|(),\"\s]+?(?=\.\.|[;|(),\"\s]|$)")
_NUMBER = re.compile(r"-?(?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][+-]?\d+)?")
_TIME_OF_DAY = re.compile(r"\d{2}:\d{2}:\d{2}(?:[.,]\d+)?Z?")
_MAX_INTEGER_CHARS: Final = len(str(2**64))
_URI = re.compile(r"[A-Za-z][A-Za-z0-9+.\-]*:\S+")


def parse(text: str, expanded: Collection[str] = (), what: str = "q") -> Term:
    """Return the tree of a query; raise a problem (400) with the position and the cause of a syntax error.

    `expanded` are the attributes whose values are terms of the @context (expandValues): their literals need
    no quotes. `what` is the name of the query in problems.
    """
    if len(text) > LONGEST:
        raise bad_request_data(f"{what} has {len(text)} characters; {LONGEST} are allowed")
    return _Parser(text, expanded, what).whole()


def readable(text: str) -> str:
    """Return a query as `parse` reads it: percent-decoded if only then it is one.

    Clients that encode the parameter `q` of a URL do the same with the member `q` of a body.
    """
    if "%" not in text or _is_query(text):
        return text
    decoded = unquote(text)
    return decoded if _is_query(decoded) else text


def _is_query(text: str) -> bool:
    try:
        parse(text)
    except Problem:
        return False
    return True


def path_of(text: str, what: str) -> Path:
    """Return a single path, such as `name` or `address[city]`; raise a problem (400) if it is invalid."""
    if len(text) > LONGEST:
        raise bad_request_data(f"{what} has {len(text)} characters; {LONGEST} are allowed")
    parser = _Parser(text, (), what)
    path = parser.path()
    if parser.at < len(text) or path.link is not None:
        parser.fail("expected the name of an attribute, such as name, name.observedAt or address[city]")
    return path


def paths(term: Term) -> Iterator[Path]:
    """Yield every path in a query."""
    if isinstance(term, And | Or):
        for part in term.terms:
            yield from paths(part)
    else:
        yield term.path


class _Parser:
    def __init__(self, text: str, expanded: Collection[str], what: str) -> None:
        self.text = text
        self.expanded = expanded
        self.what = what
        self.at = 0

    def whole(self) -> Term:
        term = self.either(0)
        if self.at < len(self.text):
            if self.text.startswith("}.", self.at - 1):
                self.fail("attributes of a linked entity are in the braces: sensor{Sensor:humidity}")
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
        values = self.values(is_term=bool(self.expanded) and self.is_expanded(path))
        if operator not in {"==", "!="} and (len(values) > 1 or isinstance(values[0], Span)):
            self.fail(f"{operator} takes one value; lists and ranges go with == and !=")
        return Compare(path, operator, values)

    def is_expanded(self, path: Path) -> bool:
        while path.link is not None:
            path = path.link.path
        return path.names[0] in self.expanded or path.names[-1] in self.expanded

    def path(self) -> Path:
        iri = self.match(_IRI)
        if iri is not None:
            names = [iri]
        else:
            names = [self.name()]
            while self.take("."):
                names.append(self.name())
        return self.rest_of_path(names, 0)

    def rest_of_path(self, names: list[str], depth: int) -> Path:
        if self.take("["):
            return Path(tuple(names), tuple(self.trail()))
        if self.take("{"):
            return Path(tuple(names), (), self.link(depth + 1))
        return Path(tuple(names))

    def link(self, depth: int) -> LinkPath:
        """Parse the braces after a relationship: `humidity`, or `Device:humidity` with a type."""
        if depth > DEEPEST:
            self.fail(f"links follow each other deeper than {DEEPEST}")
        types: list[str] = []
        names = [self.name()]
        while self.take(","):
            types.append(names.pop())
            names.append(self.name())
        # In braces a colon ends the types, so a name there has none (clause 4.9, LinkedEntityPath).
        of_type, _, name = names[0].rpartition(":")
        names = [name or self.fail("expected the name of an attribute")]
        if of_type:
            types.append(of_type)
        elif types:
            self.fail("expected : and the name of an attribute after the types")
        while self.take("."):
            names.append(self.name())
        path = self.rest_of_path(names, depth)
        if not self.take("}"):
            self.fail("expected }")
        return LinkPath(tuple(types), path)

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

    def values(self, *, is_term: bool) -> tuple[Literal | Span, ...]:
        take = self.term if is_term else self.value_or_span
        values = [take()]
        while self.take(","):
            values.append(take())
        return tuple(values)

    def term(self) -> Literal | Span:
        """Parse a term, with or without quotes; anything else is parsed as for other attributes."""
        quoted = self.match(_QUOTED)
        if quoted is not None:
            return Literal(LiteralKind.TERM, self.unquoted(quoted))
        start = self.at
        bare = self.match(_BARE) or ""
        if (
            bare not in {"true", "false"}
            and _NAME.fullmatch(bare)
            and not self.text.startswith("..", self.at)
        ):
            return Literal(LiteralKind.TERM, bare)
        self.at = start
        return self.value_or_span()

    def value_or_span(self) -> Literal | Span:
        low = self.value()
        if not self.text.startswith("..", self.at):
            return low
        self.at += 2
        high = self.value()
        if (
            low.kind is not high.kind
            or isinstance(low.value, str) is not isinstance(high.value, str)
            or low.kind is LiteralKind.TRUTH
        ):
            self.fail("a range has two numbers, two texts or two times")
        return Span(low, high)

    def value(self) -> Literal:
        quoted = self.match(_QUOTED)
        if quoted is not None:
            return Literal(LiteralKind.TEXT, self.unquoted(quoted))
        start = self.at
        bare = self.match(_BARE) or self.fail('expected a value: a number, true, a date, a URI or "text"')
        literal = _literal(bare)
        if literal is None:
            self.at = start
            self.fail(f'{shown(bare)} is no number, date or URI; text stands in double quotes: "{bare[:40]}"')
        return literal

    def pattern(self) -> Pattern:
        quoted = self.match(_QUOTED)
        text = self.unquoted(quoted) if quoted is not None else self.bare_pattern()
        try:
            return pattern(text)
        except Problem as problem:
            self.fail(problem.detail)

    def bare_pattern(self) -> str:
        """Parse an unquoted pattern: up to the ; | or ) that is not inside its own brackets."""
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
            # A pattern such as "\d+" is not a JSON string: a backslash is a backslash in it.
            text = quoted[1:-1].replace('\\"', '"')
        return text

    def take(self, sign: str) -> bool:
        if self.text.startswith(sign, self.at):
            self.at += len(sign)
            return True
        return False

    def match(self, expected: re.Pattern[str]) -> str | None:
        token = expected.match(self.text, self.at)
        if token is None:
            return None
        self.at = token.end()
        return token.group()

    def fail(self, why: str) -> NoReturn:
        raise bad_request_data(
            f"{self.what} has an error at character {self.at + 1} of {shown(self.text)}: {why}"
        )


def _number(bare: str) -> float:
    """Return a number as it is read from a body: integers are exact within 64 bits."""
    if len(bare) <= _MAX_INTEGER_CHARS and bare.lstrip("-").isdigit():
        number = int(bare)
        if -(2**63) <= number < 2**64:
            return number
    return float(bare)


def _literal(bare: str) -> Literal | None:
    if bare in {"true", "false"}:
        return Literal(LiteralKind.TRUTH, bare == "true")
    if _NUMBER.fullmatch(bare):
        return Literal(LiteralKind.NUMBER, _number(bare))
    if _TIME_OF_DAY.fullmatch(bare):
        return Literal(LiteralKind.TIME, bare)
    if bare[:1].isdigit() and "-" in bare:
        seconds = moment(bare)
        return None if seconds is None else Literal(LiteralKind.TIME, seconds)
    if _URI.fullmatch(bare):
        return Literal(LiteralKind.URI, bare)
    return None
