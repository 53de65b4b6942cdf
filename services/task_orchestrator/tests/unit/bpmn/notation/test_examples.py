"""Process files that others drew: the public examples of Camunda 7, where they are at hand."""

import os
from pathlib import Path

import pytest

from handover_bpmn.notation.file import read_bpmn
from tests.kit.paths import REPOSITORY

EXAMPLES = Path(
    os.environ.get("HANDOVER_BPMN_EXAMPLES", REPOSITORY.parent / "shared" / "data" / "bpmn_examples")
)
FILES = sorted(EXAMPLES.glob("**/*.bpmn"))

pytestmark = pytest.mark.skipif(not FILES, reason=f"no files of others in {EXAMPLES}")


@pytest.mark.parametrize("example", FILES, ids=lambda example: example.stem)
def test_a_file_of_others_is_read_unchanged(example: Path) -> None:
    found = read_bpmn(example.read_bytes())
    assert found.definitions
    for definition in found.definitions:
        assert definition.scope.nodes
