"""What is kept of a glove is whole after any crash, or it is refused by name."""

from pathlib import Path

import pytest

from handover.errors import UsageError
from services.gesture_controller.glove_store import GloveStore, StoredGlove
from services.gesture_controller.thresholds import M2O2P_THRESHOLDS

CHANGED = M2O2P_THRESHOLDS.with_changes({"ring": {"upper": 700, "lower": 600}})


def test_what_was_saved_is_loaded(tmp_path: Path) -> None:
    glove = StoredGlove("glove-1", "left", "anna", True, CHANGED, M2O2P_THRESHOLDS)
    bare = StoredGlove("glove.2")
    store = GloveStore(tmp_path / "gloves")
    store.save(StoredGlove("glove-1"))
    store.save(glove)
    store.save(bare)
    assert GloveStore(tmp_path / "gloves").load() == {"glove-1": glove, "glove.2": bare}


def test_a_store_that_was_never_written_is_empty(tmp_path: Path) -> None:
    assert GloveStore(tmp_path / "gloves").load() == {}


def test_a_file_left_half_written_by_a_crash_is_not_taken_for_a_glove(tmp_path: Path) -> None:
    store = GloveStore(tmp_path)
    store.save(StoredGlove("glove-1", thresholds=CHANGED))
    (tmp_path / "glove-1.json.new").write_text('{"hand": "ri')
    assert store.load()["glove-1"].thresholds == CHANGED


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"hand": 1'])
def test_a_damaged_file_is_named(tmp_path: Path, content: str) -> None:
    (tmp_path / "glove-1.json").write_text(content)
    with pytest.raises(UsageError, match=r"glove-1\.json cannot be read .* remove the file"):
        GloveStore(tmp_path).load()
