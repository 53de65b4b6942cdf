"""Configuration: the YAML file in which a site names its gestures, commands, persons and gloves.

    gestures:                       # all of them; without this section the 21 of M2O2P
      Thumbs up: 02222
    commands:                       # a number and the gesture that stands for it
      3: Thumbs up
    persons:                        # their own gestures for commands
      anna: {3: Horns}
    gloves:                         # without this section one, glove-1
      glove-1: {hand: right, person: anna, thresholds: {thumb: {upper: 1000, lower: 800}}}

Each mistake gets one line that names the file, the line, the rule and the way out.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from handover.errors import UsageError
from services.gesture_controller.finger_states import BENT, STRAIGHT
from services.gesture_controller.frames import is_glove_name
from services.gesture_controller.gestures import (
    M2O2P_GESTURES,
    Commands,
    Gestures,
    default_commands,
)
from services.gesture_controller.thresholds import (
    FINGERS,
    M2O2P_THRESHOLDS,
    Thresholds,
    WrongThreshold,
)

_CODE = re.compile(f"[{STRAIGHT}{BENT}]{{{len(FINGERS)}}}")


class WrongConfiguration(UsageError):
    """The gestures file cannot be used; the message says where, why and what to do."""


@dataclass(frozen=True, slots=True)
class GloveConfiguration:
    """A glove that is expected: which hand, who wears it (None: nobody by name), its thresholds."""

    name: str
    hand: str = "right"
    person: str | None = None
    thresholds: Thresholds = M2O2P_THRESHOLDS


@dataclass(frozen=True, slots=True)
class Configuration:
    """What a site has named."""

    gestures: Gestures
    commands: Commands
    persons: Mapping[str, Commands]
    """The commands of each person who has gestures of their own."""
    gloves: tuple[GloveConfiguration, ...]

    def commands_of(self, person: str | None) -> Commands:
        """Return the commands as `person` shows them."""
        return self.persons.get(person, self.commands) if person else self.commands


def built_in() -> Configuration:
    """Return the configuration used without a file: M2O2P's gestures, and glove-1 worn by operator-1."""
    gestures = Gestures(M2O2P_GESTURES)
    glove = GloveConfiguration("glove-1", person="operator-1")
    return Configuration(gestures, default_commands(gestures), {}, (glove,))


def load(path: Path | None) -> Configuration:
    """Return the configuration in the file `path`, or the built-in one; raise `WrongConfiguration`."""
    if path is None:
        return built_in()
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise WrongConfiguration(
            f"the gestures file {path} cannot be read ({error}); correct HANDOVER_GESTURES_FILE"
        ) from None
    return parse(text, path.name)


def parse(text: str, name: str = "gestures.yaml") -> Configuration:
    """Return the configuration that `text` holds; `name` is how errors call the file."""
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        where = getattr(error, "problem_mark", None)
        line = f":{where.line + 1}" if where else ""
        problem = getattr(error, "problem", None) or str(error)
        raise WrongConfiguration(f"{name}{line}: not YAML: {problem}") from None
    return _Reader(name).configuration(root)


@dataclass(frozen=True, slots=True)
class _Entry:
    """A key and its value, as written: PyYAML's types would read the code 02222 as the number 1170."""

    key: str
    line: int
    value: yaml.Node


class _Reader:
    def __init__(self, name: str) -> None:
        self._name = name

    def configuration(self, root: yaml.Node | None) -> Configuration:
        sections = {} if root is None else {entry.key: entry for entry in self._entries(root, "the file")}
        for entry in sections.values():
            if entry.key not in {"gestures", "commands", "persons", "gloves"}:
                raise self._wrong(
                    entry.line,
                    f'unknown section "{entry.key}"; the sections are gestures, commands, persons and gloves',
                )
        gestures = self._gestures(sections.get("gestures"))
        commands = self._command_map(sections.get("commands"), gestures)
        persons = self._persons(sections.get("persons"), gestures, commands)
        return Configuration(gestures, commands, persons, self._gloves(sections.get("gloves")))

    def _gestures(self, section: _Entry | None) -> Gestures:
        if section is None:
            return Gestures(M2O2P_GESTURES)
        by_code: dict[str, str] = {}
        for entry in self._entries(section.value, "gestures"):
            code = self._text(entry.value, f'the code of gesture "{entry.key}"')
            if not _CODE.fullmatch(code):
                raise self._wrong(
                    entry.line,
                    f'gesture "{entry.key}" has the code "{code}"; a code is five states, thumb first, '
                    f"each {STRAIGHT} (straight) or {BENT} (bent), such as 02222",
                )
            if code in by_code:
                raise self._wrong(
                    entry.line,
                    f'gesture "{entry.key}" has the code {code}, which "{by_code[code]}" already has; '
                    f"give one of them another code in {self._name}",
                )
            by_code[code] = entry.key
        return Gestures({name: code for code, name in by_code.items()})

    def _command_map(self, section: _Entry | None, gestures: Gestures) -> Commands:
        if section is None:
            return default_commands(gestures)
        given = self._gestures_by_command(self._entries(section.value, "commands"), gestures)
        self._refuse_two_meanings(given, section.line, "")
        return Commands(given)

    def _persons(
        self, section: _Entry | None, gestures: Gestures, commands: Commands
    ) -> Mapping[str, Commands]:
        if section is None:
            return {}
        persons: dict[str, Commands] = {}
        for person in self._entries(section.value, "persons"):
            entries = self._entries(person.value, f'person "{person.key}"')
            own = commands.with_own(self._gestures_by_command(entries, gestures))
            self._refuse_two_meanings(own.gestures, person.line, f' for "{person.key}"')
            persons[person.key] = own
        return persons

    def _gestures_by_command(self, entries: Sequence[_Entry], gestures: Gestures) -> dict[int, str]:
        by_command: dict[int, str] = {}
        for entry in entries:
            if not entry.key.isdecimal():
                raise self._wrong(entry.line, f'command "{entry.key}" is not a whole number such as 3')
            name = self._text(entry.value, f"the gesture of command {entry.key}")
            known = gestures.find(name)
            if known is None:
                raise self._wrong(
                    entry.line, f'command {entry.key} has the unknown gesture "{name}"; {gestures.like(name)}'
                )
            by_command[int(entry.key)] = known
        return by_command

    def _refuse_two_meanings(self, by_command: Mapping[int, str], line: int, whose: str) -> None:
        seen: dict[str, int] = {}
        for command, gesture in by_command.items():
            if gesture in seen:
                raise self._wrong(
                    line,
                    f'"{gesture}" stands for the commands {seen[gesture]} and {command}{whose}; '
                    "give one of them another gesture",
                )
            seen[gesture] = command

    def _gloves(self, section: _Entry | None) -> tuple[GloveConfiguration, ...]:
        if section is None:
            return built_in().gloves
        gloves: list[GloveConfiguration] = []
        wearers: dict[str, str] = {}
        for entry in self._entries(section.value, "gloves"):
            glove = self._glove(entry)
            if glove.person and wearers.setdefault(glove.person, glove.name) != glove.name:
                raise self._wrong(
                    entry.line,
                    f'person "{glove.person}" wears both {wearers[glove.person]} and {glove.name}; '
                    "a Task for a person needs one glove, so name another person or none",
                )
            gloves.append(glove)
        return tuple(gloves)

    def _glove(self, entry: _Entry) -> GloveConfiguration:
        if not is_glove_name(entry.key):
            raise self._wrong(
                entry.line, f'glove "{entry.key}": a name is 1 to 64 letters, digits, ".", "_" or "-"'
            )
        hand, person, thresholds = "right", None, M2O2P_THRESHOLDS
        fields = self._entries(entry.value, f'glove "{entry.key}"') if not _is_empty(entry.value) else []
        for given in fields:
            if given.key == "hand":
                hand = self._text(given.value, f'the hand of glove "{entry.key}"')
                if hand not in {"left", "right"}:
                    raise self._wrong(given.line, f'glove "{entry.key}": hand is left or right, not "{hand}"')
            elif given.key == "person":
                person = self._text(given.value, f'the person of glove "{entry.key}"')
            elif given.key == "thresholds":
                thresholds = self._thresholds(entry.key, given)
            else:
                raise self._wrong(
                    given.line,
                    f'glove "{entry.key}" has an unknown field "{given.key}"; '
                    "there are hand, person and thresholds",
                )
        return GloveConfiguration(entry.key, hand, person, thresholds)

    def _thresholds(self, glove: str, section: _Entry) -> Thresholds:
        thresholds = M2O2P_THRESHOLDS
        for finger in self._entries(section.value, f'the thresholds of glove "{glove}"'):
            bounds = {
                bound.key: self._number(bound, f"{finger.key} {bound.key}")
                for bound in self._entries(finger.value, f'finger "{finger.key}"')
            }
            try:
                thresholds = thresholds.with_changes({finger.key: bounds})
            except WrongThreshold as error:
                raise self._wrong(finger.line, f'glove "{glove}": {error}') from None
        return thresholds

    def _entries(self, node: yaml.Node, what: str) -> list[_Entry]:
        if not isinstance(node, yaml.MappingNode):
            raise self._wrong(_line(node), f'{what} must be names with values ("name: value" lines)')
        entries: dict[str, _Entry] = {}
        for entry in self._pairs(node, what):
            if entry.key in entries:
                raise self._wrong(
                    entry.line,
                    f'"{entry.key}" stands twice in {what}, first in line {entries[entry.key].line}; '
                    "remove or rename one of them",
                )
            entries[entry.key] = entry
        return list(entries.values())

    def _pairs(self, node: yaml.MappingNode, what: str) -> Iterator[_Entry]:
        for key, value in node.value:
            yield _Entry(self._text(key, f"a name in {what}"), _line(key), value)

    def _text(self, node: yaml.Node, what: str) -> str:
        if not isinstance(node, yaml.ScalarNode) or not node.value.strip():
            raise self._wrong(_line(node), f"{what} must be a word or a number")
        return str(node.value)

    def _number(self, entry: _Entry, what: str) -> float:
        text = self._text(entry.value, what)
        try:
            return float(text)
        except ValueError:
            raise self._wrong(entry.line, f'{what} must be a number, not "{text}"') from None

    def _wrong(self, line: int, why: str) -> WrongConfiguration:
        return WrongConfiguration(f"{self._name}:{line}: {why}")


def _line(node: yaml.Node) -> int:
    return int(node.start_mark.line) + 1


def _is_empty(node: yaml.Node) -> bool:
    return isinstance(node, yaml.ScalarNode) and not node.value.strip()
