"""The gesture controller follows who has joined the station of a glove, from a running `accounts`."""

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest
import uvicorn

from handover.security.guard import Guard
from handover.security.keys_in_force import KeysInForce
from handover.security.proofs.performer_proof import require_proven_performer
from handover.settings import Settings
from handover_accounts.app import make_app
from handover_accounts.set_up import set_up
from handover_accounts.settings import AccountsSettings
from handover_accounts.storage.identifiers import IdentifierKind, set_identifier
from handover_accounts.storage.stations import add_station
from handover_accounts.storage.users import add_user, set_person
from handover_gloves.people.station_joins import StationJoins
from tests.kit.ports import next_free_port

ANNA = "urn:ngsi-ld:Person:demo:anna"
TASK = "urn:ngsi-ld:Task:demo:p-1"


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(60):
        while not condition():
            await asyncio.sleep(0.05)


@pytest.fixture
def settings(tmp_path: Path) -> AccountsSettings:
    return AccountsSettings(data_dir=tmp_path, accounts_port=next_free_port(), _env_file=None)


async def test_without_accounts_nobody_is_proved(settings: AccountsSettings) -> None:
    local = Settings(data_dir=settings.data_dir, accounts_port=settings.accounts_port, _env_file=None)
    async with Guard(local, "gesture-controller") as guard:
        assert await StationJoins(guard).proof_of(ANNA, TASK) is None


async def test_accounts_that_do_not_answer_delay_no_task(settings: AccountsSettings) -> None:
    set_up(settings, ["gesture-controller"])
    common = Settings(data_dir=settings.data_dir, accounts_port=settings.accounts_port, _env_file=None)
    async with Guard(common, "gesture-controller") as guard:
        assert await StationJoins(guard).proof_of(ANNA, TASK) is None


@pytest.mark.nightly
async def test_a_gesture_without_a_task_joins_and_leaves_the_station_of_the_glove(
    settings: AccountsSettings,
) -> None:
    set_up(settings, ["gesture-controller", "accounts"])
    app = make_app(settings)
    server = uvicorn.Server(uvicorn.Config(app, port=settings.accounts_port, log_config=None))
    serving = asyncio.create_task(server.serve())
    await until(lambda: server.started)
    directory = app.state.directory
    with directory.store.change("test") as change:
        anna = add_user(change, "Anna", None)
        set_person(change, anna, ANNA)
        set_identifier(change, directory.identifiers, anna, IdentifierKind.GESTURE, "Horns")
        add_station(change, "Station 1", ["glove-1"], 15.0)
    common = Settings(data_dir=settings.data_dir, accounts_port=settings.accounts_port, _env_file=None)
    async with Guard(common, "gesture-controller") as guard:
        joins = StationJoins(guard)
        tasks = [asyncio.create_task(joins.follow()), asyncio.create_task(joins.send())]
        await until(lambda: "glove-1" in joins._persons)
        assert joins.person_at("glove-1") is None
        joins.held("glove-2", "Horns")
        joins.held("glove-1", "Thumbs up")
        joins.held("glove-1", "Horns")
        await until(lambda: joins.person_at("glove-1") == ANNA)
        assert joins.person_at("glove-2") is None
        joins.held("glove-1", "Horns")
        await until(lambda: joins.person_at("glove-1") is None)
        proof = await joins.proof_of(ANNA, TASK)
        keys = KeysInForce(common.security_folder).keys()
        assert keys is not None
        require_proven_performer(keys, TASK, {"performedBy": ANNA, "performerProof": proof})
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    server.should_exit = True
    await serving
