"""YAML files with line numbers, so that every error message names the file and the line.

Values stay strings: YAML types would convert the code 02222 to the number 1170.

Two limits are checked on the stream of parser events, before any object is built: the nesting depth, and the
number of values with every alias (`*name`) expanded.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import yaml

from handover.errors import UsageError

MAX_DEPTH = 50
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""libyaml, if PyYAML was built with it, is about ten times faster than the Python parser."""


class WrongFile(UsageError):
    """A file is invalid; the message names the line, the rule and the remedy."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A key and its value."""

    key: str
    line: int
    value: yaml.Node


class LinedYaml:
    """Reads the file called `name`; raises `mistake` for an invalid file."""

    mistake: type[WrongFile] = WrongFile
    max_values = 1_000_000

    def __init__(self, name: str) -> None:
        self.name = name

    def compose(self, text: str) -> yaml.Node | None:
        """Return the root node of `text`, None if it is empty."""
        try:
            self._check_bounds(text)
            return yaml.compose(text, Loader=_LOADER)
        except yaml.YAMLError as error:
            where = getattr(error, "problem_mark", None)
            line = f":{where.line + 1}" if where else ""
            problem = getattr(error, "problem", None) or str(error)
            raise self.mistake(f"{self.name}{line}: not YAML: {problem}") from None

    def _check_bounds(self, text: str) -> None:
        """Raise `mistake` if `text` is nested too deeply or has too many values, aliases expanded."""
        open_collections: list[tuple[str | None, int]] = []
        sizes: dict[str, int | None] = {}
        """The number of values of each anchor; None until its end."""
        count = 0
        for event in yaml.parse(text, Loader=_LOADER):
            line = event.start_mark.line + 1 if event.start_mark else 1
            if isinstance(event, yaml.AliasEvent):
                size = sizes.get(str(event.anchor), 1)
                if size is None:
                    raise self.wrong(line, f"*{event.anchor} stands within itself; write its value out")
                count += size
            elif isinstance(event, yaml.ScalarEvent):
                count += 1
                if event.anchor is not None:
                    sizes[event.anchor] = 1
            elif isinstance(event, yaml.CollectionStartEvent):
                open_collections.append((event.anchor, count))
                count += 1
                if event.anchor is not None:
                    sizes[event.anchor] = None
                if len(open_collections) > MAX_DEPTH:
                    raise self.wrong(
                        line, f"nested too deeply; {MAX_DEPTH} levels are allowed, write names and values"
                    )
            elif isinstance(event, yaml.CollectionEndEvent):
                anchor, before = open_collections.pop()
                if anchor is not None:
                    sizes[anchor] = count - before
            if count > self.max_values:
                raise self.wrong(
                    line, f"too many values; {self.max_values} are allowed, aliases counted in full"
                )

    def entries(self, node: yaml.Node, what: str) -> list[Entry]:
        """Return the entries of a mapping; a repeated name is an error."""
        if not isinstance(node, yaml.MappingNode):
            raise self.wrong(line_of(node), f'{what} must be names with values ("name: value" lines)')
        entries: dict[str, Entry] = {}
        for entry in self._pairs(node, what):
            if entry.key in entries:
                raise self.wrong(
                    entry.line,
                    f'"{entry.key}" stands twice in {what}, first in line {entries[entry.key].line}; '
                    "remove or rename one of them",
                )
            entries[entry.key] = entry
        return list(entries.values())

    def _pairs(self, node: yaml.MappingNode, what: str) -> Iterator[Entry]:
        for key, value in node.value:
            yield Entry(self.text(key, f"a name in {what}"), line_of(key), value)

    def text(self, node: yaml.Node, what: str) -> str:
        """Return a word or a number as a string."""
        if not isinstance(node, yaml.ScalarNode) or not node.value.strip():
            raise self.wrong(line_of(node), f"{what} must be a word or a number")
        return str(node.value)

    def number(self, entry: Entry, what: str) -> float:
        """Return a number."""
        text = self.text(entry.value, what)
        try:
            return float(text)
        except ValueError:
            raise self.wrong(entry.line, f'{what} must be a number, not "{text}"') from None

    def wrong(self, line: int, why: str) -> WrongFile:
        """Return the error for `line`."""
        return self.mistake(f"{self.name}:{line}: {why}")


def line_of(node: yaml.Node) -> int:
    """Return the line in which `node` begins, from 1."""
    return int(node.start_mark.line) + 1


def is_empty(node: yaml.Node) -> bool:
    """Return True for an empty value."""
    return isinstance(node, yaml.ScalarNode) and not node.value.strip()
