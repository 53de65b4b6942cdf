"""The schema files are those of the models, and say what the models say."""

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from handover_datamodels import TYPES, schemas
from handover_datamodels.schemas.__main__ import main


def test_the_schema_files_are_current() -> None:
    assert schemas.outdated() == []
    assert main(["--check"]) == 0


def test_a_stale_file_fails_the_check_until_it_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(schemas.outdated, "__defaults__", (tmp_path,))
    monkeypatch.setattr(schemas.write, "__defaults__", (tmp_path,))
    assert main(["--check"]) == 1
    assert (
        "Task.json differs from the models; run python -m handover_datamodels.schemas"
        in capsys.readouterr().err
    )
    assert main([]) == 0
    assert "wrote Task.json" in capsys.readouterr().out
    assert main(["--check"]) == 0
    (tmp_path / "Task.json").write_text("{}", encoding="utf-8")
    assert main(["--check"]) == 1


@pytest.mark.parametrize("name", TYPES)
def test_a_schema_is_a_schema_without_dangling_references(name: str) -> None:
    schema = schemas.schema_of(TYPES[name])
    jsonschema.Draft202012Validator.check_schema(schema)
    text = json.dumps(schema)
    for definition in schema["$defs"]:
        assert f"#/$defs/{definition}" in text
    assert "Property_" not in text


@pytest.mark.parametrize(
    ("name", "attribute", "wrong"),
    [
        ("Task", "status", {"type": "Property", "value": "done"}),
        ("Task", "involves", {"type": "Relationship", "object": "urn:x:y"}),
        ("Task", "involves", {"type": "Property", "value": [{"type": "Relationship"}]}),
        ("Task", "workParameters", {"type": "Property", "value": "pick"}),
        ("Task", "deadline", {"type": "Property", "value": "2026-03-02T07:20:00Z"}),
        ("Task", "isDefinedBy", {"type": "Relationship", "object": "no URI"}),
        ("Task", "status", None),
        ("Device", "commandId", {"type": "Property", "value": 1.5}),
        ("Device", "deviceState", {"type": "Property", "value": "fine"}),
        ("Device", "source", {"type": "GeoProperty", "value": "x"}),
        ("Alert", "severity", {"type": "Property", "value": "awful"}),
        ("Alert", "location", {"type": "GeoProperty", "value": {"type": "Somewhere"}}),
        ("Alert", "humanVerified", {"type": "Property", "value": "yes"}),
    ],
)
def test_a_schema_refuses_what_the_model_refuses(name: str, attribute: str, wrong: Any) -> None:
    folder = schemas.FOLDER.parent / "examples"
    example = json.loads((folder / f"{name.lower()}.json").read_text(encoding="utf-8"))
    schema = json.loads((schemas.FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    jsonschema.validate(example, schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**example, attribute: wrong}, schema)
