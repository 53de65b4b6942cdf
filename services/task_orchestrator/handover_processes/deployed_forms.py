"""Registry: all versions of the deployed forms, by id and by the name of their file."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import orjson

from handover.errors import Problem
from handover_bpmn.forms.form_js import FormFile


@dataclass(frozen=True, slots=True)
class FormRecord:
    """A deployed version of a form; versions of an id count from 1. `file` is the name of its file."""

    id: str
    version: int
    title: str
    file: str | None
    digest: str
    content: bytes = field(repr=False)
    deployed_at: datetime


class FormRegistry:
    """All forms."""

    def __init__(self) -> None:
        self._records: dict[str, list[FormRecord]] = {}
        self._schemas: dict[tuple[str, int], Mapping[str, Any]] = {}

    def add(self, records: Iterable[FormRecord]) -> None:
        """Add `records`, in the order of their versions."""
        for record in records:
            self._records.setdefault(record.id, []).append(record)

    def latest(self) -> list[FormRecord]:
        """Return the latest version of each form."""
        return [self._records[name][-1] for name in sorted(self._records)]

    def record(self, form_id: str, version: int | None = None) -> FormRecord:
        """Return a version of a form, by default the latest; raise `Problem` 404 if there is none."""
        form = self.find(form_id, version)
        if form is None:
            raise Problem.translated(
                404,
                "No such form",
                "form.unknown",
                'there is no form "{form}" of this version; deploy it with POST /forms',
                form=form_id,
            )
        return form

    def find(self, form_id: str, version: int | None = None) -> FormRecord | None:
        """Return a version of a form, by default the latest; None if there is none."""
        versions = self._records.get(form_id, [])
        if version is None:
            return versions[-1] if versions else None
        return versions[version - 1] if 1 <= version <= len(versions) else None

    def find_file(self, name: str) -> FormRecord | None:
        """Return the latest version of the form whose file has this name."""
        named = [record for records in self._records.values() for record in records if record.file == name]
        return max(named, key=lambda record: record.deployed_at, default=None)

    def deployed_by(self, form_id: str, moment: datetime) -> FormRecord | None:
        """Return the version that was the latest at `moment`; the first one if all are later."""
        versions = self._records.get(form_id, [])
        earlier = [record for record in versions if record.deployed_at <= moment]
        return earlier[-1] if earlier else next(iter(versions), None)

    def schema(self, record: FormRecord) -> Mapping[str, Any]:
        """Return the JSON of a form."""
        key = record.id, record.version
        if key not in self._schemas:
            self._schemas[key] = orjson.loads(record.content)
        return self._schemas[key]

    def next_version(
        self, form: FormFile, content: bytes, file: str | None, beside: Sequence[FormRecord], now: datetime
    ) -> tuple[FormRecord, bool]:
        """Return the record that a deployment of `form` results in, and whether it is new.

        `beside` are the records of other deployments in the same step.
        """
        versions = [
            *self._records.get(form.id, []),
            *(deployed for deployed in beside if deployed.id == form.id),
        ]
        digest = hashlib.sha256(content).hexdigest()
        if versions and versions[-1].digest == digest and versions[-1].file == file:
            return versions[-1], False
        return FormRecord(form.id, len(versions) + 1, form.title, file, digest, content, now), True
