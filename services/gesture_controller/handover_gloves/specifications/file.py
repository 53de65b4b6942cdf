"""Specification files, which are imported into the database:

confirm-grip:                      # the last part of the TaskDefinition's URN, or the whole URN
  name: Confirm the grip
  description: Look whether the gripper holds the part
  commandId: 4                     # or gesture: Thumbs up
"""

from collections.abc import Mapping

import yaml

from handover.tasks.specification import FIELDS, Specification
from handover_gloves.configuration.lined_yaml import Entry, LinedYaml, WrongFile, is_empty
from handover_gloves.specifications.definition import Definition


class WrongSpecification(WrongFile):
    """A specification file is invalid; the message names the line, the rule and the remedy."""


def read(text: str, name: str = "specifications.yaml") -> dict[str, Definition]:
    """Return the definitions in `text` by id; raise `WrongSpecification`, which calls the file `name`."""
    reader = _Reader(name)
    root = reader.compose(text)
    if root is None:
        return {}
    return {entry.key: reader.definition(entry) for entry in reader.entries(root, "the file")}


def written(definitions: Mapping[str, Specification]) -> str:
    """Return `definitions` as such a file."""
    document = {key: definition.as_values() for key, definition in definitions.items()}
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True)


class _Reader(LinedYaml):
    mistake = WrongSpecification

    def definition(self, entry: Entry) -> Definition:
        values = {
            field.key: field
            for field in ([] if is_empty(entry.value) else self.entries(entry.value, f'"{entry.key}"'))
        }
        for field in values.values():
            if field.key not in FIELDS:
                raise self.wrong(
                    field.line,
                    f'"{entry.key}" has an unknown field "{field.key}"; there are {", ".join(FIELDS)}',
                )
        name, description, gesture = (
            self.text(values[field].value, f'the {field} of "{entry.key}"') if field in values else None
            for field in FIELDS[:3]
        )
        definition = Definition(name, description, gesture, self._command(entry, values.get("commandId")))
        if definition == Definition():
            raise self.wrong(
                entry.line, f'"{entry.key}" says nothing; give it a description, and a gesture or a commandId'
            )
        return definition

    def _command(self, entry: Entry, field: Entry | None) -> int | None:
        if field is None:
            return None
        text = self.text(field.value, f'the commandId of "{entry.key}"')
        if not text.isdecimal() or int(text) >= 2**31:
            raise self.wrong(
                field.line, f'the commandId of "{entry.key}" is a whole number such as 3, not "{text}"'
            )
        return int(text)
