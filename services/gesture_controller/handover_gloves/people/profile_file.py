"""The profile of a person as a YAML file, readable by people and portable between sites.

    person: anna
    title: Anna Virtanen
    commands:                        # a number and her gesture for it, null for none
      3: Wave off
    gestures:                        # her own
      Mine: '20200'
      Recorded: {code: '20000', sample: {glove: glove-1, levels: [...], noise: [...]}}
      Wave off: {sequence: [Mine, Horns]}
    gloves:                          # how each glove fits her
      glove-1: {recognizer: thresholds, thresholds: {thumb: {upper: 1000, lower: 800}}, learnt: {...}}

Export and import preserve every value.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import orjson
import yaml
from yaml.constructor import SafeConstructor

from handover_gloves.calibration.fitting import SAMPLES
from handover_gloves.calibration.glove_store import Fit
from handover_gloves.configuration.gestures_file import Configuration, Reader
from handover_gloves.configuration.lined_yaml import Entry, WrongFile, is_empty, line_of
from handover_gloves.people.person import (
    MAX_OWN_GESTURES,
    PERSON_RULE,
    OwnGesture,
    Person,
    Sample,
    WrongCommand,
    commands_of,
)
from handover_gloves.recognition.frames import is_glove_name
from handover_gloves.recognition.gestures import Gestures, WrongGesture
from handover_gloves.recognition.thresholds import FINGERS

MAX_VALUES = 20_000
MAX_SAMPLES = 3 ** len(FINGERS)
SECTIONS = ("person", "title", "commands", "gestures", "gloves")


class WrongProfile(WrongFile):
    """The profile is invalid; the message names the line, the rule and the remedy."""


@dataclass(frozen=True, slots=True)
class Profile:
    """A person and their fits by glove."""

    person: Person
    fits: Mapping[str, Fit]


def written(profile: Profile) -> str:
    """Return `profile` as YAML."""
    person = profile.person
    document: dict[str, Any] = {"person": person.name}
    if person.title:
        document["title"] = person.title
    if person.commands:
        document["commands"] = dict(person.commands)
    if person.gestures:
        document["gestures"] = {name: _written_gesture(own) for name, own in person.gestures.items()}
    if profile.fits:
        document["gloves"] = {glove: _written_fit(fit) for glove, fit in profile.fits.items()}
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True, default_flow_style=None, width=100)


def read(text: str, site: Configuration, name: str = "profile.yaml", person: str | None = None) -> Profile:
    """Return the profile in `text`, for `person` if given, else for the person it names.

    Raises `WrongProfile`, which calls the file `name`, also for conflicts with the `site`.
    """
    reader = _ProfileReader(name)
    return reader.profile(reader.compose(text), site, person)


class _ProfileReader(Reader):
    mistake = WrongProfile
    max_values = MAX_VALUES

    def profile(self, root: yaml.Node | None, site: Configuration, whose: str | None) -> Profile:
        if root is None:
            raise self.wrong(1, "the profile is empty; it begins with person: and a name")
        sections = {entry.key: entry for entry in self.entries(root, "the profile")}
        for entry in sections.values():
            if entry.key not in SECTIONS:
                allowed = f"{', '.join(SECTIONS[:-1])} and {SECTIONS[-1]}"
                raise self.wrong(entry.line, f'unknown section "{entry.key}"; the sections are {allowed}')
        if "person" not in sections:
            raise self.wrong(1, "nobody is named; write person: and a name")
        name = self.text(sections["person"].value, "the name of the person")
        if not is_glove_name(name):
            raise self.wrong(sections["person"].line, f'person "{name}": {PERSON_RULE}')
        title = self.text(sections["title"].value, "the title") if "title" in sections else None
        every, gestures = self._own_gestures(sections.get("gestures"), site.gestures)
        person = Person(whose or name, title, self._own_commands(sections.get("commands")), gestures)
        try:
            commands_of(person, site.commands_of(person.name), every)
        except WrongCommand as error:
            lines = {entry.key: entry.line for entry in self.entries(sections["commands"].value, "commands")}
            raise self.wrong(lines.get(str(error.command), sections["commands"].line), str(error)) from None
        gloves = sections.get("gloves")
        entries = self.entries(gloves.value, "gloves") if gloves else []
        return Profile(person, {entry.key: self._fit(entry) for entry in entries})

    def _own_commands(self, section: Entry | None) -> dict[int, str | None]:
        commands: dict[int, str | None] = {}
        for entry in self.entries(section.value, "commands") if section else []:
            if not entry.key.isdecimal():
                raise self.wrong(entry.line, f'command "{entry.key}" is not a whole number such as 3')
            none = is_empty(entry.value) or entry.value.tag == "tag:yaml.org,2002:null"
            gesture = None if none else self.text(entry.value, f"the gesture of command {entry.key}")
            commands[int(entry.key)] = gesture
        return commands

    def _own_gestures(
        self, section: Entry | None, usable: Gestures
    ) -> tuple[Gestures, dict[str, OwnGesture]]:
        """Return all gestures, including those `known`, and the person's own ones."""
        entries = self.entries(section.value, "gestures") if section else []
        if section is not None and len(entries) > MAX_OWN_GESTURES:
            raise self.wrong(section.line, f"a person has {MAX_OWN_GESTURES} gestures of their own at most")
        gestures = {entry.key: self._gesture(entry) for entry in entries}
        for entry in sorted(entries, key=lambda own_entry: gestures[own_entry.key].shape.code is None):
            try:
                usable = usable.with_shapes({entry.key: gestures[entry.key].shape})
            except WrongGesture as error:
                raise self.wrong(entry.line, str(error)) from None
        return usable, gestures

    def _gesture(self, entry: Entry) -> OwnGesture:
        if not isinstance(entry.value, yaml.MappingNode):
            return OwnGesture(self.shape(entry))
        parts = self.entries(entry.value, f'gesture "{entry.key}"')
        sample = next((self._sample(part) for part in parts if part.key == "sample"), None)
        node = yaml.MappingNode(
            entry.value.tag,
            [(key, value) for key, value in entry.value.value if key.value != "sample"],
            entry.value.start_mark,
        )
        return OwnGesture(self.shape(Entry(entry.key, entry.line, node)), sample)

    def _sample(self, entry: Entry) -> Sample:
        parts = {part.key: part for part in self.entries(entry.value, "the sample")}
        if set(parts) != {"glove", "levels", "noise"}:
            raise self.wrong(entry.line, "a sample has glove, levels and noise, and nothing else")
        glove = self.text(parts["glove"].value, "the glove of the sample")
        return Sample(glove, self._five(parts["levels"]), self._five(parts["noise"]))

    def _five(self, entry: Entry) -> tuple[float, ...]:
        if not isinstance(entry.value, yaml.SequenceNode) or len(entry.value.value) != len(FINGERS):
            raise self.wrong(entry.line, f"the {entry.key} of a sample are five numbers, thumb first")
        return tuple(
            self.number(Entry(entry.key, line_of(node), node), entry.key) for node in entry.value.value
        )

    def _fit(self, entry: Entry) -> Fit:
        if not is_glove_name(entry.key):
            raise self.wrong(
                entry.line, f'glove "{entry.key}": a name is 1 to 64 letters, digits, ".", "_" or "-"'
            )
        thresholds, recognizer, learnt = None, None, {}
        for part in [] if is_empty(entry.value) else self.entries(entry.value, f'glove "{entry.key}"'):
            if part.key == "thresholds":
                thresholds = self.thresholds(entry.key, part)
            elif part.key == "recognizer":
                recognizer = self.text(part.value, f'the recognizer of glove "{entry.key}"')
            elif part.key == "learnt":
                learnt = self._learnt(part)
            else:
                raise self.wrong(
                    part.line,
                    f'glove "{entry.key}" has an unknown field "{part.key}"; '
                    "there are thresholds, recognizer and learnt",
                )
        return Fit(thresholds, None, recognizer, learnt)

    def _learnt(self, entry: Entry) -> dict[str, Any]:
        self.entries(entry.value, "learnt")
        try:
            learnt = SafeConstructor().construct_document(entry.value)
            orjson.dumps(learnt)
        except (yaml.YAMLError, ValueError, TypeError) as error:
            raise self.wrong(entry.line, f"what was learnt cannot be read: {error}") from None
        if len(learnt.get(SAMPLES) or ()) > MAX_SAMPLES:
            raise self.wrong(
                entry.line, f"{MAX_SAMPLES} samples are allowed, one for each way to hold a hand"
            )
        return {str(topic): taught for topic, taught in learnt.items()}


def _written_gesture(own: OwnGesture) -> Any:
    if own.sample is None and own.shape.code is not None:
        return own.shape.code
    if own.sample is None:
        return own.shape.as_dict()
    sample = {
        "glove": own.sample.glove,
        "levels": _plain(own.sample.levels),
        "noise": _plain(own.sample.noise),
    }
    return {**own.shape.as_dict(), "sample": sample}


def _written_fit(fit: Fit) -> dict[str, Any]:
    document: dict[str, Any] = {}
    if fit.recognizer is not None:
        document["recognizer"] = fit.recognizer
    if fit.thresholds is not None:
        document["thresholds"] = {
            finger: dict(zip(bounds, _plain(bounds.values()), strict=True))
            for finger, bounds in fit.thresholds.as_dict().items()
        }
    if fit.learnt:
        document["learnt"] = dict(fit.learnt)
    return document


def _plain(numbers: Any) -> list[float]:
    """Return whole numbers as integers: 800, not 800.0; true and false stay."""
    return [
        number if isinstance(number, bool) else int(number) if float(number).is_integer() else float(number)
        for number in numbers
    ]
