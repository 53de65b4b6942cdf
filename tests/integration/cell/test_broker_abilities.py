"""What another broker can do: found out by probes, kept, shown by the doctor, on the page and as metrics."""

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from handover.broker import MAX_FAULTS, BrokerClient, BrokerUnavailable
from handover.broker.abilities import ABILITIES, FILE, TYPE, find_abilities
from handover.runtime.python_processes import module_command
from handover.settings import Settings
from tests.kit.cell import Cell, new_cell
from tests.kit.other_broker.running import orion_like
from tests.kit.processes import clean_environment
from tests.kit.refusing_proxy import RefusingProxy, refusing_proxy
from tests.kit.waiting import wait_for

pytestmark = pytest.mark.slow

MISSING = {"history", "largeIntegers", "listsOfOne", "instances"}


@pytest.fixture
def proxy(shared_cell: Cell, tmp_path: Path) -> Iterator[RefusingProxy]:
    """A proxy before a broker that speaks as Orion-LD."""
    with orion_like(shared_cell.environment, tmp_path) as orion, refusing_proxy(orion) as made:
        yield made


def settings_for(url: str, data_dir: Path, shared_cell: Cell) -> Settings:
    shared_cell.run("context_broker")
    context = f"{shared_cell.url('context_broker')}/context.jsonld"
    return Settings.load(broker_url=url, data_dir=data_dir, context_url=context)


@pytest.mark.nightly
async def test_probes_find_what_is_missing_and_leave_nothing_behind(
    shared_cell: Cell, proxy: RefusingProxy, tmp_path: Path
) -> None:
    settings = settings_for(proxy.url, tmp_path, shared_cell)
    proxy.refused = frozenset({b"/ngsi-ld/ex/v1/version"})  # so that all is tried
    proxy.status = 404
    async with BrokerClient(settings) as broker:
        found = await find_abilities(broker, settings)
        assert {one.name for one in found.missing()} == MISSING
        assert "datasetId" not in b"".join(body for _, body in proxy.accepted).decode()
        assert await broker.query(type=TYPE) == []
        assert await broker.subscriptions() == []


async def test_a_known_version_is_not_tried_and_what_was_found_is_kept(
    shared_cell: Cell, proxy: RefusingProxy, tmp_path: Path
) -> None:
    settings = settings_for(proxy.url, tmp_path, shared_cell)
    async with BrokerClient(settings) as broker:
        first = await find_abilities(broker, settings)
        assert {one.name for one in first.missing()} == MISSING
        tried = [body for _, body in proxy.accepted if b"HandoverProbe" in body]
        assert len(tried) == 1, "lists of one depend on a flag"
        assert (await find_abilities(broker, settings)).are_there == first.are_there
        again = [body for _, body in proxy.accepted if b"HandoverProbe" in body]
        assert len(again) == 2, "lists of one are there as soon as the flag is"
        (tmp_path / FILE).write_text("{")
        assert (await find_abilities(broker, settings)).are_there == first.are_there


async def test_what_is_there_is_not_tried_again(
    shared_cell: Cell, proxy: RefusingProxy, tmp_path: Path
) -> None:
    settings = settings_for(proxy.url, tmp_path, shared_cell)
    async with BrokerClient(settings) as broker:
        await find_abilities(broker, settings)
        document = json.loads((tmp_path / FILE).read_text())
        document["abilities"]["listsOfOne"] = True
        (tmp_path / FILE).write_text(json.dumps(document))
        proxy.accepted.clear()
        assert "listsOfOne" not in {one.name for one in (await find_abilities(broker, settings)).missing()}
    assert not [body for _, body in proxy.accepted if b"HandoverProbe" in body]


async def test_an_ability_at_which_the_broker_fails_is_missing(
    shared_cell: Cell, proxy: RefusingProxy, tmp_path: Path
) -> None:
    settings = settings_for(proxy.url, tmp_path, shared_cell)
    proxy.refused, proxy.status = frozenset({b'/entities{"id":"urn:ngsi-ld:HandoverProbe'}), 500
    async with BrokerClient(settings) as broker:
        found = await find_abilities(broker, settings)
    assert {one.name for one in found.missing()} == MISSING
    assert proxy.refusals == MAX_FAULTS


async def test_our_own_broker_can_do_everything_and_is_not_tried(shared_cell: Cell, tmp_path: Path) -> None:
    settings = settings_for(shared_cell.url("context_broker"), tmp_path, shared_cell)
    async with BrokerClient(settings) as broker:
        found = await find_abilities(broker, settings)
    assert found.missing() == []
    assert not (tmp_path / FILE).exists()


async def test_a_broker_that_cannot_be_reached_has_no_abilities(
    shared_cell: Cell, proxy: RefusingProxy, tmp_path: Path
) -> None:
    settings = settings_for(proxy.url, tmp_path, shared_cell)
    proxy.refused = frozenset({b"HandoverProbe"})
    async with BrokerClient(settings) as broker:
        with pytest.raises(BrokerUnavailable):
            await find_abilities(broker, settings)
    assert not (tmp_path / FILE).exists()


@pytest.mark.nightly
def test_the_doctor_says_it_before_a_cell_runs(proxy: RefusingProxy, tmp_path: Path) -> None:
    """Nothing serves our @context then."""
    given = {"HANDOVER_BROKER_URL": proxy.url, "HANDOVER_CONTEXT_URL": "http://127.0.0.1:9/none"}
    environment = {**clean_environment(), "HANDOVER_DATA_DIR": str(tmp_path), **given}
    command = [*module_command("handover_cell"), "doctor"]
    run = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert re.search(r"ok +broker http://\S+: Orion-LD 1\.6\.0", run.stdout)


@pytest.mark.nightly
def test_the_doctor_the_page_and_the_metrics_say_it(proxy: RefusingProxy, tmp_path: Path) -> None:
    folder = tmp_path / "cell"
    folder.mkdir()
    with new_cell(folder) as cell:
        cell.extra["HANDOVER_BROKER_URL"] = proxy.url
        cell.extra["HANDOVER_CONTEXT_URL"] = f"{cell.url('task_orchestrator')}/context.jsonld"
        cell.start("task_orchestrator", "webui", within_s=120)

        def metrics() -> dict[str, str]:
            text = httpx.get(f"{cell.url('webui')}/metrics", timeout=120, trust_env=False).text
            return dict(re.findall(r'^handover_broker_ability{ability="(\w+)"} (\S+)$', text, re.MULTILINE))

        wait_for(lambda: len(metrics()) == len(ABILITIES))
        assert {name for name, is_there in metrics().items() if float(is_there) == 0} == MISSING
        command = [*module_command("handover_cell"), "doctor"]
        run = subprocess.run(
            command, env=cell.environment, cwd=folder, capture_output=True, text=True, check=False
        )
        done = run.stdout
        assert re.search(r"ok +broker http://\S+: Orion-LD 1\.6\.0", done)
        assert re.search(r"missing +broker http://\S+: history is not there: .*Mintaka", done)
