"""Our types against those of a ROS that is installed, where there is one: hashes, defaults and CDR."""

import importlib
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from handover_ros.errors import UnsupportedType
from handover_ros.types.type_store import TypeStore
from tests.kit.skipping import NO_ROS


def shares() -> list[Path]:
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    return [
        Path(one) / "share" for one in prefixes if one and (Path(one) / "share" / "std_msgs" / "msg").is_dir()
    ]


pytestmark = [
    pytest.mark.skipif(not shares(), reason=NO_ROS),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]


@pytest.fixture(scope="module")
def genuine() -> TypeStore:
    return TypeStore(shares())


def test_definitions_have_the_hashes_of_the_installed_ros(genuine: TypeStore) -> None:
    compared = 0
    for share in shares():
        for file in share.rglob("*.json"):
            described = json.loads(file.read_text())
            for one in described.get("type_hashes", []) if isinstance(described, dict) else []:
                try:
                    assert genuine.hash(one["type_name"]) == one["hash_string"], one["type_name"]
                except UnsupportedType:
                    assert "WString" in one["type_name"]
                else:
                    compared += 1
    assert compared


def test_shipped_definitions_equal_the_installed_ones(genuine: TypeStore) -> None:
    ours = TypeStore()
    both = set(ours.type_names()) & {name for name in genuine.type_names() if "/msg/" in name}
    assert "sensor_msgs/msg/JointState" in both
    for name in sorted(both):
        assert genuine.hash(name) == ours.hash(name), name
        assert genuine.encode(name, {}) == ours.encode(name, {}), name


def interface(type_name: str) -> Any:
    package, kind, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError):
        return None


def test_messages_have_the_bytes_and_defaults_of_the_installed_ros(genuine: TypeStore) -> None:
    serialization = pytest.importorskip("rclpy.serialization")
    compared = 0
    for name in genuine.type_names():
        made = interface(name) if "/msg/" in name else None
        if made is None or name == "test_msgs/msg/WStrings":
            continue
        theirs = serialization.serialize_message(made())
        message = genuine.decode(name, theirs)
        assert genuine.encode(name, message) == genuine.encode(name, {}), name
        assert serialization.deserialize_message(genuine.encode(name, {}), made) == made(), name
        compared += 1
    assert compared


@pytest.mark.parametrize("text", ["", "world", "wörld €", "ハローワールド", "over 16 bits: 😀"])
def test_wide_texts_are_those_of_the_installed_ros(genuine: TypeStore, text: str) -> None:
    serialization = pytest.importorskip("rclpy.serialization")
    made = interface("test_msgs/msg/WStrings")
    theirs = made(wstring_value=text, unbounded_sequence_of_wstrings=[text, "b"])
    read = genuine.decode("test_msgs/msg/WStrings", serialization.serialize_message(theirs))
    assert (read["wstring_value"], list(read["unbounded_sequence_of_wstrings"])) == (text, [text, "b"])
    written = genuine.encode("test_msgs/msg/WStrings", read)
    assert serialization.deserialize_message(written, made) == theirs
