"""Examples, ours and the published ones, come through the models unchanged and satisfy the schemas."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest

import handover_datamodels
from handover_datamodels import TYPES, Entity, Form, read
from handover_datamodels.schemas import schema_of

OURS = sorted((Path(handover_datamodels.__file__).parent / "examples").glob("*.json"))
PUBLISHED_NAMES = [
    "agv",
    "alert",
    "asset",
    "material",
    "person",
    "process",
    "processCompose",
    "sensor",
    "task",
]
PUBLISHED_FOLDER = Path(handover_datamodels.__file__).parents[3] / "shared" / "data" / "shop4cf_examples"


def loaded(path: Path) -> dict[str, Any]:
    entity: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return entity


@pytest.fixture(
    params=[*OURS, *PUBLISHED_NAMES], ids=lambda given: getattr(given, "stem", f"shop4cf-{given}")
)
def example(request: pytest.FixtureRequest) -> Iterator[dict[str, Any]]:
    if isinstance(request.param, Path):
        yield loaded(request.param)
        return
    if not PUBLISHED_FOLDER.is_dir():
        pytest.skip(f"the published examples are not here ({PUBLISHED_FOLDER})")
    yield loaded(PUBLISHED_FOLDER / f"{request.param}.json")


def test_every_type_has_an_example() -> None:
    assert {loaded(path)["type"] for path in OURS} == set(TYPES)


def test_an_example_comes_back_unchanged(example: dict[str, Any]) -> None:
    entity = read(example)
    assert type(entity) is not Entity
    assert json.dumps(entity.to_normalized(), sort_keys=True) == json.dumps(example, sort_keys=True)


def test_an_example_comes_back_from_its_concise_form(example: dict[str, Any]) -> None:
    entity = read(example)
    again = read(entity.to_concise())
    assert again == entity
    assert again.to_normalized() == example
    assert len(json.dumps(entity.to_concise())) < len(json.dumps(example))


def test_bare_values_of_an_example_are_read_to_the_same_values(example: dict[str, Any]) -> None:
    bare = read(example).to_key_values()
    assert read(bare).to_key_values() == bare
    assert read(bare, Form.KEY_VALUES).to_key_values() == bare


def test_an_example_satisfies_its_schema_and_a_broken_one_does_not(example: dict[str, Any]) -> None:
    validator = jsonschema.Draft202012Validator(schema_of(TYPES[example["type"]]))
    validator.validate(example)
    for required in TYPES[example["type"]].model_json_schema()["required"]:
        assert not validator.is_valid({name: value for name, value in example.items() if name != required})
    attributes = [name for name, value in example.items() if isinstance(value, dict) and name != "status"]
    for attribute in attributes:
        assert not validator.is_valid({**example, attribute: {"type": "Nonsense"}})
    assert not validator.is_valid({**example, "type": "Room"})
