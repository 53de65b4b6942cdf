"""Damage: any damaged files serve what was acknowledged, or are refused by name."""

import os
import random
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from handover.errors import UsageError
from handover_broker.storage.database import NotStored, SqliteDatabase
from handover_broker.storage.entries import DocumentKind, EntityRow, Entries, PendingNotification
from handover_broker.storage.history_archive import HistoryRow, TemporalOnlyRow
from handover_broker.storage.journal import SCHEMA_VERSION, SCRIPT, Journal

TRIALS = int(os.environ.get("HANDOVER_TEST_DAMAGES", "12"))
"""Parametrized by the kind of damage and the state of the files."""
SUBSCRIPTION = "urn:ngsi-ld:Subscription:1"


@dataclass
class Model:
    """The acknowledged state."""

    entities: dict[int, bytes] = field(default_factory=dict)
    documents: dict[str, bytes] = field(default_factory=dict)
    history: dict[tuple[int, int], bytes] = field(default_factory=dict)
    temporal_only: dict[int, bytes] = field(default_factory=dict)
    pending: list[bytes] = field(default_factory=list)

    def everything(self) -> Any:
        return (
            [body for _, body in sorted(self.entities.items())],
            dict(sorted(self.documents.items())),
            dict(sorted(self.history.items())),
            dict(sorted(self.temporal_only.items())),
            self.pending,
        )


def commit(journal: Journal, model: Model, chance: random.Random) -> None:
    """Commit something of every kind."""
    entries = Entries()
    place = chance.randint(1, 40)
    body = chance.randbytes(chance.choice([5, 80, 700, 6000]))
    seq = 1_000_000 + len(model.history)
    if place in model.entities and chance.random() < 0.2:
        entries.entities[place] = EntityRow("", f"urn:{place}", None)
        entries.temporal_only[place] = TemporalOnlyRow("", f"urn:{place}", body)
        del model.entities[place]
        model.temporal_only[place] = body
    elif place not in model.temporal_only:
        entries.entities[place] = EntityRow("", f"urn:{place}", body)
        model.entities[place] = body
    entries.history.append(HistoryRow(place, seq, chance.choice([None, 1.5]), None, 0, body))
    model.history[place, seq] = body
    if chance.random() < 0.3:
        name = f"urn:document:{chance.randint(1, 5)}"
        entries.documents[DocumentKind.CONTEXT, "", name] = model.documents[name] = body
    if chance.random() < 0.3:
        entries.pending.append(PendingNotification("", SUBSCRIPTION, f"urn:{place}", 2.5, body))
        model.pending.append(body)
    journal.commit(entries)


def served(folder: Path) -> Any:
    """Open the files in a folder, and read everything."""
    journal = Journal(SqliteDatabase(folder / "broker.db"))
    try:
        journal.open()
        history = {(place, seq): body for place, seq, _, body in journal.archive.history(range(1, 41))}
        return (
            [body for _, body in journal.entities()],
            {name: body for _, name, body in journal.documents(DocumentKind.CONTEXT)},
            dict(sorted(history.items())),
            {place: body for place, _, body in journal.archive.temporal_only_entities("")},
            [one.body for one in journal.pending("", SUBSCRIPTION, 0, 10_000)],
        )
    finally:
        journal.close()


@contextmanager
def written(folder: Path, chance: random.Random, count: int) -> Iterator[tuple[Journal, Model]]:
    folder.mkdir()
    journal, model = Journal(SqliteDatabase(folder / "broker.db")), Model()
    journal.open()
    subscription = Entries(documents={(DocumentKind.SUBSCRIPTION, "", SUBSCRIPTION): b"{}"})
    journal.commit(subscription)
    for number in range(count):
        commit(journal, model, chance)
        if number == count // 2:
            journal.settle()
    yield journal, model
    journal.close()


def copied(folder: Path, into: Path) -> None:
    into.mkdir(parents=True)
    for file in folder.glob("broker.*"):
        if not file.name.endswith((".lock", "-shm")):
            shutil.copy(file, into / file.name)


@dataclass
class Scene:
    """Files of a broker that was killed or stopped, what they hold, and files of an older and another one."""

    now: Path
    older: Path
    stranger: Path
    wanted: Any


@pytest.fixture(scope="module", params=["killed", "stopped"])
def scene(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder, chance = tmp_path_factory.mktemp("scene"), random.Random(13)
    with written(folder / "stranger", chance, 30) as (journal, _):
        copied(folder / "stranger", folder / "of-a-stranger")
    with written(folder / "own", chance, 60) as (journal, model):
        copied(folder / "own", folder / "older")
        for _ in range(5):
            commit(journal, model, chance)
        journal.settle()
        for _ in range(15):
            commit(journal, model, chance)
        if request.param == "killed":
            copied(folder / "own", folder / "now")
    if request.param == "stopped":
        copied(folder / "own", folder / "now")
    return Scene(folder / "now", folder / "older", folder / "of-a-stranger", model.everything())


Damage = Callable[[Path, Scene, random.Random], None]


def flip_bits(folder: Path, _: Scene, chance: random.Random) -> None:
    """Flip one to five bits, some of them where something is written."""
    file = chance.choice([one for one in folder.glob("broker.*") if one.stat().st_size])
    content = bytearray(file.read_bytes())
    used = len(content.rstrip(b"\0"))
    for _ in range(chance.randint(1, 5)):
        content[chance.randrange(used if chance.random() < 0.9 else len(content))] ^= 1 << chance.randrange(8)
    file.write_bytes(content)


def cut(folder: Path, _: Scene, chance: random.Random) -> None:
    file = chance.choice([one for one in folder.glob("broker.*") if one.stat().st_size])
    os.truncate(file, chance.randrange(file.stat().st_size))


def cut_log(folder: Path, _: Scene, chance: random.Random) -> None:
    file = folder / chance.choice(["broker.log-1", "broker.log-2"])
    os.truncate(file, chance.randrange(file.stat().st_size))


def delete(folder: Path, _: Scene, chance: random.Random) -> None:
    chance.choice(list(folder.glob("broker.*"))).unlink()


def delete_log(folder: Path, _: Scene, chance: random.Random) -> None:
    for file in chance.choice([["broker.log-1"], ["broker.log-2"], ["broker.log-1", "broker.log-2"]]):
        (folder / file).unlink()


def empty(folder: Path, _: Scene, chance: random.Random) -> None:
    os.truncate(chance.choice(list(folder.glob("broker.*"))), 0)


def empty_database(folder: Path, _: Scene, chance: random.Random) -> None:
    for file in folder.glob("broker.db*"):
        file.unlink()
    if chance.random() < 0.5:
        (folder / "broker.db").touch()
    else:
        with closing(sqlite3.connect(folder / "broker.db")) as database:
            database.execute("VACUUM")


def swap_log(folder: Path, scene: Scene, chance: random.Random) -> None:
    other = chance.choice([scene.older, scene.stranger])
    for name in chance.choice([["broker.log-1"], ["broker.log-2"], ["broker.log-1", "broker.log-2"]]):
        shutil.copy(other / name, folder / name)


def swap_database(folder: Path, scene: Scene, chance: random.Random) -> None:
    other = chance.choice([scene.older, scene.stranger])
    for file in folder.glob("broker.db*"):
        file.unlink()
    for file in other.glob("broker.db*"):
        shutil.copy(file, folder / file.name)


@pytest.mark.parametrize(
    "damage",
    [flip_bits, cut, cut_log, delete, delete_log, empty, empty_database, swap_log, swap_database],
)
def test_damage_is_never_served(scene: Scene, tmp_path: Path, damage: Damage) -> None:
    assert served_copy(scene, tmp_path / "sound") == scene.wanted
    for number in range(TRIALS if damage in {flip_bits, cut_log} else max(6, TRIALS // 6)):
        chance = random.Random(f"{damage.__name__} {number}")
        folder = tmp_path / str(number)
        copied(scene.now, folder)
        damage(folder, scene, chance)
        found = served_or_refused(folder)
        if isinstance(found, str):
            assert "broker." in found, number
            assert "\n" not in found, number
        else:
            assert found == scene.wanted, f"trial {number} of {damage.__name__} serves something else"
        shutil.rmtree(folder)


def served_copy(scene: Scene, folder: Path) -> Any:
    copied(scene.now, folder)
    return served(folder)


def served_or_refused(folder: Path) -> Any:
    """Return what the files serve, or the error line."""
    try:
        return served(folder)
    except (UsageError, NotStored) as error:
        return str(error)


def test_a_log_beside_a_database_that_was_never_in_use_is_not_overwritten(tmp_path: Path) -> None:
    new = SqliteDatabase(tmp_path / "new" / "broker.db")
    new.open(SCHEMA_VERSION, SCRIPT)
    new.close()
    with written(tmp_path / "used", random.Random(1), 3):
        copied(tmp_path / "used", tmp_path / "mixed")
    for file in (tmp_path / "mixed").glob("broker.db*"):
        file.unlink()
    shutil.copy(tmp_path / "new" / "broker.db", tmp_path / "mixed" / "broker.db")
    logs = {file: file.read_bytes() for file in (tmp_path / "mixed").glob("broker.log-*")}
    with pytest.raises(UsageError, match=r"damaged data: .*broker\.log-1 holds changes of another database"):
        served(tmp_path / "mixed")
    assert {file: file.read_bytes() for file in logs} == logs
