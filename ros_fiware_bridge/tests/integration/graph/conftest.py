import os
import random
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager, contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest

from handover_ros.graph.joining import Adapter, JoinSettings, installed, join
from handover_ros.graph.port import RosGraph
from handover_ros.types.type_store import TypeStore
from tests.kit.skipping import ROS_TYPES
from tests.kit.waiting import scaled, until

# An installed ROS uses this machine alone, like our own DDS by its settings.
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
TYPES = Path(__file__).parent / "types"
REPEAT = "rcl_interfaces/srv/ListParameters"
Joined = Callable[..., AbstractAsyncContextManager[RosGraph]]


# The dependencies of rclpy use deprecated features of Python.
_OLD = {Adapter.RCLPY: [pytest.mark.filterwarnings("ignore::DeprecationWarning")]}
_ADAPTERS = [
    pytest.param(one, id=one.value, marks=_OLD.get(one, []))
    for one in installed()
    if one not in {Adapter.ROSBRIDGE, Adapter.AUTO}  # their own tests cover the rest
]


@pytest.fixture(scope="module", params=_ADAPTERS or [None])
def adapter(request: pytest.FixtureRequest) -> Adapter:
    if request.param is None:
        pytest.skip("no adapter is installed")
    return Adapter(request.param)


@pytest.fixture(scope="module")
def domain_id(request: pytest.FixtureRequest) -> int:
    """An even number of six per module, so that modules that run in parallel do not share a domain.

    The ports of domains from 101 on overlap with the ephemeral ports of the system.
    """
    modules = sorted(one.stem for one in Path(__file__).parent.glob("test_*.py"))
    return modules.index(Path(str(request.path)).stem) % 15 * 6 + 2 * random.randint(1, 3)


@contextmanager
def running_script(
    script: str, *arguments: str, environment: Mapping[str, str] = MappingProxyType({})
) -> Iterator[subprocess.Popen[str]]:
    """Run a script of this folder, which prints "ready" and ends when its input does."""
    with subprocess.Popen(
        [sys.executable, str(Path(__file__).parent / script), *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    ) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        try:
            assert process.stdout.readline() == "ready\n"
            yield process
        finally:
            process.stdin.close()
            try:
                process.wait(120)
            finally:
                process.kill()


@contextmanager
def running_peer(adapter: Adapter, domain_id: int, *type_paths: Path) -> Iterator[subprocess.Popen[str]]:
    with running_script("peer.py", adapter.value, str(domain_id), *map(str, type_paths)) as process:
        yield process


@pytest.fixture(scope="module")
def peer(adapter: Adapter, domain_id: int) -> Iterator[subprocess.Popen[str]]:
    with running_peer(adapter, domain_id) as process:
        yield process


@pytest.fixture(scope="session")
def store() -> TypeStore:
    return TypeStore([TYPES])


@pytest.fixture
def joined(adapter: Adapter, domain_id: int, store: TypeStore) -> Joined:
    @asynccontextmanager
    async def graph(**settings: Any) -> AsyncIterator[RosGraph]:
        types = settings.pop("store", store)
        opened = await join(
            types,
            JoinSettings(
                **{"node": "tested", "domain_id": domain_id, "interfaces": ("127.0.0.1",), **settings}
            ),
            adapter,
        )
        try:
            yield opened
        finally:
            await opened.close()

    return graph


@pytest.fixture
async def graph(joined: Joined) -> AsyncIterator[RosGraph]:
    async with joined() as opened:
        yield opened


@pytest.fixture
def only_cyclone(adapter: Adapter) -> None:
    if adapter is not Adapter.CYCLONE:
        pytest.skip(ROS_TYPES)


async def true(holds: Callable[[], Any], timeout_s: float = 20.0) -> None:
    await until(holds, timeout_s)


async def repeated(graph: RosGraph, text: str, times: int, timeout_s: float | None = None) -> list[str]:
    request = {"prefixes": [text], "depth": times}
    answer = await graph.call("/repeat", REPEAT, request, timeout_s or scaled(10))
    return list(answer["result"]["names"])


def part(folder: Path, text: str) -> Path:
    file = folder / "cell_msgs" / "msg" / "Part.msg"
    file.parent.mkdir(parents=True)
    file.write_text(text)
    return folder
