"""Gloves and fits survive a restart; files of an earlier version are imported once."""

from dataclasses import replace
from pathlib import Path

import orjson
import pytest
from sqlalchemy import Engine

from handover.errors import UsageError
from handover_gloves.calibration.glove_store import NOBODY, Fit, GloveStore, StoredGlove
from handover_gloves.people.person import Person
from handover_gloves.people.store import PeopleStore
from handover_gloves.recognition.thresholds import M2O2P_THRESHOLDS

CHANGED = M2O2P_THRESHOLDS.with_changes({"ring": {"upper": 700, "lower": 600}})
OLD = {
    "hand": "left",
    "person": "anna",
    "declared": False,
    "thresholds": CHANGED.as_dict(),
    "previous": M2O2P_THRESHOLDS.as_dict(),
}


def test_what_was_saved_is_loaded(database: Engine) -> None:
    store = GloveStore(database)
    assert (store.load(), store.fits()) == ({}, {})
    glove = StoredGlove("glove-1", "left", "anna", True)
    store.save(StoredGlove("glove-1"), StoredGlove("glove.2"))
    store.save(glove)
    fit = Fit(CHANGED, M2O2P_THRESHOLDS, "personal", {"levels": {"ring": {"fist": 1.5}}})
    kept = store.save_fit(glove, "anna", fit)
    store.save_fit(glove, None, Fit())
    again = GloveStore(database)
    assert again.load() == {"glove-1": glove, "glove.2": StoredGlove("glove.2")}
    assert again.fits()["glove-1", "anna"] == kept == replace(fit, changed_at=kept.changed_at)
    assert again.fits()["glove-1", NOBODY].thresholds is None
    PeopleStore(database).save_profile(Person("anna"), {"glove.2": Fit(CHANGED)})
    assert set(store.fits()) == {("glove-1", NOBODY), ("glove.2", "anna")}


def test_the_files_of_an_earlier_version_are_imported_once(database: Engine, tmp_path: Path) -> None:
    (tmp_path / "glove-1.json").write_bytes(orjson.dumps(OLD))
    (tmp_path / "glove-2.json").write_bytes(orjson.dumps({**OLD, "declared": True, "thresholds": None}))
    (tmp_path / "glove-3.json.new").write_text('{"hand": "ri')
    store = GloveStore(database, tmp_path)
    assert store.load() == {
        "glove-1": StoredGlove("glove-1", "left"),
        "glove-2": StoredGlove("glove-2", "left", "anna", True),
    }
    assert list(store.fits()) == [("glove-1", "anna")]
    assert store.fits()["glove-1", "anna"].thresholds == CHANGED
    store.save_fit(StoredGlove("glove-1"), "anna", Fit(M2O2P_THRESHOLDS))
    again = GloveStore(database, tmp_path)
    again.load()
    assert again.fits()["glove-1", "anna"].thresholds == M2O2P_THRESHOLDS


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"hand": 1'])
def test_a_damaged_file_is_named(database: Engine, tmp_path: Path, content: str) -> None:
    (tmp_path / "glove-1.json").write_text(content)
    with pytest.raises(UsageError, match=r"glove-1\.json cannot be read .* remove the file"):
        GloveStore(database, tmp_path).load()
