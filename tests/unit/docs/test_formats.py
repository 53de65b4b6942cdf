"""The formats of files and bodies that the documentation shows are those of the code, and complete."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import BaseModel

from glove_sdk_bridge.errors import BridgeError, Dropped
from glove_sdk_bridge.frames import Frame, parse_frame
from glove_sdk_bridge.replay import read_table
from handover.errors import UsageError
from handover_devices.command_line.device import add
from handover_devices.model.description import DeviceDescription
from handover_processes.documents.requests import (
    ClaimRequest,
    CommentRequest,
    CompleteRequest,
    DeclineRequest,
    ReturnRequest,
)
from tests.kit.paths import REPOSITORY

DOCS = REPOSITORY / "docs"
BODIES: dict[str, type[BaseModel]] = {
    "claim": ClaimRequest,
    "return": ReturnRequest,
    "decline": DeclineRequest,
    "complete": CompleteRequest,
    "comments": CommentRequest,
}
TASKS = (DOCS / "how-to" / "tasks-for-people.md").read_text(encoding="utf-8")


def section(page: str, heading: str) -> str:
    """Return the text below a heading, up to the next one of any level."""
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.split(r"^#+ ", text.split(f"# {heading}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def descriptions() -> list[Any]:
    return [
        yaml.safe_load(block)
        for block in blocks(section("how-to/devices.md", "The description file"), "yaml")
    ]


@pytest.mark.parametrize("description", descriptions(), ids=lambda one: one["kind"])
def test_a_description_of_a_device_in_the_documentation_is_valid(description: Any) -> None:
    DeviceDescription.model_validate(description)


def test_the_documentation_names_every_member_of_a_description_of_a_device() -> None:
    text = section("how-to/devices.md", "The description file")
    schema = DeviceDescription.model_json_schema()
    parts = [schema, *(part for part in schema["$defs"].values() if "properties" in part)]
    members = {name for part in parts for name in part["properties"]}
    kinds = set(schema["$defs"]["DeviceKind"]["enum"]) | set(schema["$defs"]["CommandKind"]["enum"])
    named = set(re.findall(r"`(\w+)`", text))
    assert members | kinds <= named


@pytest.mark.parametrize("content", ["", "- kind: sensor\n", "name: hall-1\ndescription: {kind: sensor}\n"])
def test_a_file_that_describes_no_device_is_refused_with_its_name(content: str, tmp_path: Path) -> None:
    file = tmp_path / "hall-1.yaml"
    file.write_text(content)
    with pytest.raises(UsageError, match=r'hall-1\.yaml describes no device: it needs "kind"'):
        add("hall-1", None, file)


@pytest.mark.parametrize("act", BODIES)
def test_the_documentation_names_every_member_of_a_body_of_the_tasklist(act: str) -> None:
    (row,) = re.findall(rf"^\| `POST /tasks/{{id}}/{act}` \|(.*)\|$", TASKS, re.MULTILINE)
    fields = BODIES[act].model_fields
    assert set(fields) <= set(re.findall(r"`(\w+)`", row))


def test_the_bodies_of_the_tasklist_in_the_documentation_are_valid() -> None:
    shown = re.findall(r"/tasks/TASK/(\w+) .*?-d '(.*?)'", TASKS, re.DOTALL)
    assert {act for act, _ in shown} == {"claim", "complete"}
    for act, body in shown:
        BODIES[act].model_validate(json.loads(body))


def test_the_table_of_poses_in_the_documentation_can_be_played(tmp_path: Path) -> None:
    (table,) = blocks(section("tutorials/first-glove.md", "A CSV table of poses"), "csv")
    file = tmp_path / "poses.csv"
    file.write_text(table)
    dropped = Dropped(str(file), print)
    rows = list(read_table(file, dropped))
    assert [pose for pose, _ in rows] == ["fist", "fist", "open"]
    assert rows[0][1].bend == (310, 290, 305, 300, 320)
    assert not dropped


class ReadOnce:
    """A driver whose glove is switched off after its values."""

    def __init__(self, values: list[tuple[int, ...]]) -> None:
        self._values = iter(values)

    def read(self) -> tuple[int, ...] | None:
        return next(self._values, None)


def test_the_glove_source_in_the_documentation_yields_frames_of_the_protocol() -> None:
    source_kind, example = blocks(section("how-to/extend.md", "A glove source"), "python")
    names: dict[str, Any] = {"add_arguments": print, "make": print}
    exec(source_kind, names)
    exec(example, names)
    source = names["MyGlove"](ReadOnce([(1012, 640, 598, 701, 850)]))
    assert source.patience_s == 0.0
    assert source.dropped is None
    frames: Iterator[Frame] = source.frames()
    first = next(frames)
    assert parse_frame(first.encode()).bend == (1012, 640, 598, 701, 850)
    with pytest.raises(BridgeError, match="switch it on"):
        next(frames)
