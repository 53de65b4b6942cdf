"""Fixtures of every test: cells, databases, recordings; and what a run may skip."""

import functools
import itertools
import os
import signal
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import httpx
import hypothesis
import pytest
from httpx._transports import default as transports

from tests.kit.cell import Cell, new_cell
from tests.kit.other_broker import running
from tests.kit.paths import RECORDINGS
from tests.kit.ports import next_free_port
from tests.kit.skipping import is_allowed_to_skip
from tests.kit.time_limits import scale_alarm
from tests.kit.waiting import wait_for

DEFAULT_EXAMPLES = 25
EXAMPLES = int(os.environ.get("HANDOVER_TEST_EXAMPLES", DEFAULT_EXAMPLES))
"""How many examples each property test tries. More than the default are drawn at random, but not in CI:
whether CI accepts a change must not depend on chance."""

hypothesis.settings.register_profile(
    "handover",
    max_examples=EXAMPLES,
    derandomize=EXAMPLES <= DEFAULT_EXAMPLES or bool(os.environ.get("CI")),
    deadline=None,  # a slow machine must not fail a test
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("handover")

# Each client would load all certificate authorities (15 ms), and the tests make thousands of clients.
transports.create_ssl_context = functools.cache(httpx.create_ssl_context)

os.environ.update(running.settings())  # for services in the process of a test

if (
    signal.getsignal(signal.SIGINT) is signal.SIG_IGN
):  # a shell's background job ignores it, and so its children
    signal.signal(signal.SIGINT, signal.default_int_handler)

_tenants = itertools.count(1)


def pytest_configure(config: pytest.Config) -> None:
    """Report what another broker can do, if the tests run with one."""
    if running.IS_OTHER:
        from tests.kit.other_broker.report import BrokerReport

        config.pluginmanager.register(BrokerReport())


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Distribute the tests by what they share, if there are several workers."""
    from tests.kit.scheduling import GroupScheduling

    return GroupScheduling(config, log)


@pytest.hookimpl(wrapper=True, optionalhook=True)
def pytest_timeout_set_timer(settings: Any) -> Generator[None, Any, Any]:
    """Let the time limit of each test grow with the load of the machine."""
    result = yield
    scale_alarm(settings.timeout)
    return result


STARTS_SERVICES = frozenset({"cell", "shared_cell", "host_cell", "own_broker"})
"""The fixtures with which a test starts services for itself or for its module."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark each test that starts services as slow: `make check` leaves it out."""
    for item in items:
        if isinstance(item, pytest.Function) and not STARTS_SERVICES.isdisjoint(item.fixturenames):
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, Any, Any]:
    """Fail a test that skips in CI or in `make ros-test` for a reason that is not allowed there."""
    report = yield
    if report.skipped and not is_allowed_to_skip(str(report.longrepr)):
        report.outcome = "failed"
        report.longrepr = f"{item.nodeid} was skipped, which CI does not allow: {report.longrepr}"
    return report


@pytest.fixture
def free_port() -> Callable[[], int]:
    """Return a function that gives a free port at each call."""
    return next_free_port


@pytest.fixture(scope="session")
def new_database() -> Callable[[], str]:
    """Return a function that makes a database on one PostgreSQL server and returns its URL."""
    from tests.kit.postgres import shared_server

    return shared_server().new_database


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of real glove recordings; skips where it is absent."""
    if not RECORDINGS.is_dir():
        pytest.skip(f"the glove recordings are not here ({RECORDINGS})")
    return RECORDINGS


@pytest.fixture
def eventually() -> Callable[..., Any]:
    """Wait for a condition with a bound; returns its value."""
    return wait_for


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    """A cell of which nothing runs yet, for one test."""
    with new_cell(tmp_path) as made:
        yield made


@pytest.fixture(scope="session")
def host_cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """A cell of a broker alone, for cells that are its tenants."""
    with new_cell(tmp_path_factory.mktemp("host")) as made:
        yield made


@pytest.fixture
def tenant_cell(cell: Cell, host_cell: Cell) -> Cell:
    """A cell with an empty tenant of a broker that other tests use too."""
    host_cell.run("context_broker")
    cell.host, cell.tenant = host_cell, f"cell-{next(_tenants)}"
    cell.ports["context_broker"] = host_cell.ports["context_broker"]
    return cell


@pytest.fixture(scope="module")
def shared_cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """A cell for all tests of a module, which use different ids. Each test starts what it needs."""
    with new_cell(tmp_path_factory.mktemp("cell")) as made:
        yield made
