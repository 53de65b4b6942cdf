"""YAML with line numbers: `on` is a string, 010 is not 8, and a duplicate key is an error."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import yaml

from handover.errors import UsageError

Where: TypeAlias = tuple[str | int, ...]
"""The keys and indexes from the root of the file to a value."""

MAX_NODES = 50_000
_NUMBER = re.compile(r"[-+]?(0|[1-9]\d*)")
_DECIMAL = re.compile(r"[-+]?(\.\d+|\d+(\.\d*)?)([eE][-+]?\d+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_WORDS: Mapping[str, Any] = {
    "true": True,
    "false": False,
    "null": None,
    "~": None,
    "": None,
}


class NotYaml(UsageError):
    """The text cannot be parsed; `line` counts from 1."""

    def __init__(self, line: int, why: str) -> None:
        super().__init__(why)
        self.line = line


@dataclass(frozen=True, slots=True)
class Written:
    """The content of a file, and the line (from 1) of each value."""

    content: Any
    lines: Mapping[Where, int]

    def line_of(self, where: Where) -> int:
        """Return the line of the value at `where`, or of the nearest value that contains it."""
        while where and where not in self.lines:
            where = where[:-1]
        return self.lines.get(where, 1)


def read(text: str) -> Written:
    """Return the content of `text`. Raises `NotYaml`."""
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error)
        raise NotYaml(mark.line + 1 if mark else 1, f"this is not YAML: {problem}") from None
    except RecursionError:
        raise NotYaml(1, "the file is nested too deeply") from None
    reader = _Reader()
    return Written(None if root is None else reader.value(root, ()), reader.lines)


class _Reader:
    def __init__(self) -> None:
        self.lines: dict[Where, int] = {}
        self._count = 0
        self._inside: list[yaml.Node] = []

    def value(self, node: yaml.Node, where: Where) -> Any:
        line = int(node.start_mark.line) + 1
        self.lines.setdefault(where, line)
        self._count += 1
        if self._count > MAX_NODES:
            raise NotYaml(line, f"the file contains more than {MAX_NODES} values")
        if isinstance(node, yaml.ScalarNode):
            return _scalar(node)
        if node in self._inside:
            raise NotYaml(line, "an alias (*) refers to a value that contains it")
        self._inside.append(node)
        try:
            if isinstance(node, yaml.SequenceNode):
                return [self.value(item, (*where, index)) for index, item in enumerate(node.value)]
            return self._mapping(node, where)
        finally:
            self._inside.pop()

    def _mapping(self, node: yaml.Node, where: Where) -> dict[Any, Any]:
        made: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            line = int(key_node.start_mark.line) + 1
            if not isinstance(key_node, yaml.ScalarNode):
                raise NotYaml(line, "a key must be a word or a number")
            key = _scalar(key_node)
            place = (*where, key if isinstance(key, str | int) else str(key))
            if key in made:
                raise NotYaml(
                    line,
                    f'"{key}" is a duplicate key, first in line {self.lines[place]}; remove or rename one',
                )
            self.lines[place] = line
            made[key] = self.value(value_node, place)
        return made


def _scalar(node: yaml.ScalarNode) -> Any:
    text = str(node.value)
    if node.style is not None:
        return text
    if text.lower() in _WORDS and text in {text.lower(), text.capitalize(), text.upper()}:
        return _WORDS[text.lower()]
    if _NUMBER.fullmatch(text):
        return int(text) if len(text) < 40 else text
    if _DECIMAL.fullmatch(text) and not re.fullmatch(r"[-+]?\d+", text):
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    return text
