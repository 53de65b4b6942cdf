"""The broker that a cell has in place of our own, as processes."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from services.context_broker.tests.integration.conftest import BrokerProcess
from tests.kit import processes
from tests.kit.databases import broker_settings
from tests.kit.other_broker.abilities import value
from tests.kit.other_broker.profiles import ORION_LD, PLAIN
from tests.kit.other_broker.running import QUERY, OtherBroker
from tests.kit.ports import next_free_port

pytestmark = pytest.mark.slow

ENTITY = {"id": "urn:ngsi-ld:Thing:demo:1", "type": "Thing", "n": value(2147483648)}


class Running:
    """Another broker that runs."""

    def __init__(self, folder: Path, profile: str, url: str = "") -> None:
        folder.mkdir()
        self._folder, self._port = folder, next_free_port()
        self._broker = OtherBroker(self._port, folder, profile, url)
        self._process: processes.Process | None = None
        self.url = f"http://127.0.0.1:{self._port}"

    def start(self) -> None:
        log = self._folder / "log"
        environment = {
            **processes.clean_environment(),
            "HANDOVER_DATA_DIR": str(self._folder),
            **broker_settings(self._folder),
        }
        self._process = self._broker.spawn(environment, log)
        processes.wait_ready(self._process, f"{self.url}{QUERY}", log.read_text)

    def kill(self) -> None:
        assert self._process is not None
        processes.kill(self._process)
        self._broker.kill()

    def stop(self) -> None:
        if self._process is not None and self._process.poll() is None:
            processes.stop(self._process)
        self._broker.stop()

    def create(self) -> int:
        return httpx.post(
            f"{self.url}/ngsi-ld/v1/entities", json=ENTITY, trust_env=False, timeout=120
        ).status_code

    def read(self) -> object:
        answer = httpx.get(f"{self.url}/ngsi-ld/v1/entities/{ENTITY['id']}", trust_env=False, timeout=120)
        return answer.json()["n"]["value"] if answer.is_success else answer.status_code


@pytest.fixture
def made() -> Iterator[list[Running]]:
    brokers: list[Running] = []
    yield brokers
    for one in brokers:
        one.stop()


@pytest.mark.nightly
def test_the_strict_broker_is_killed_and_started_again_with_what_it_stores(
    tmp_path: Path, made: list[Running]
) -> None:
    made.append(Running(tmp_path / "cell", ORION_LD.name))
    broker = made[0]
    broker.start()
    assert (broker.create(), broker.read()) == (201, -2147483648)
    broker.kill()
    with pytest.raises(httpx.TransportError):
        broker.read()
    broker.start()
    assert (broker.create(), broker.read()) == (409, -2147483648)


def test_cells_of_one_broker_by_url_do_not_meet(tmp_path: Path, made: list[Running]) -> None:
    shared = BrokerProcess(tmp_path).start()
    try:
        made += [Running(tmp_path / name, PLAIN.name, shared.url) for name in ("a", "b")]
        for broker in made:
            broker.start()
        first, second = made
        assert (first.create(), first.read(), second.read()) == (201, 2147483648, 404)
        assert (second.create(), second.read()) == (201, 2147483648)
        first.kill()
        first.start()
        assert first.read() == 2147483648
        with shared.client() as client:
            assert client.get(f"/entities/{ENTITY['id']}").status_code == 404
    finally:
        shared.stop()
