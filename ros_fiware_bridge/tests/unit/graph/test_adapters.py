"""Adapters of the ROS graph: ours, and those of other packages."""

from pathlib import Path

import pytest

from handover.extensions import UnknownExtension
from handover_ros.graph.joining import ADAPTERS, Adapter, JoinSettings, installed, join, load_adapter
from handover_ros.types.type_store import TypeStore

pytest.importorskip("cyclonedds")

ACME = """
from dataclasses import replace

from handover_ros.graph.joining import Adapter
from handover_ros.graph.joining import join as join_ours


async def join(store, settings):
    return await join_ours(store, replace(settings, namespace="/acme"), Adapter.CYCLONE)
"""


@pytest.fixture
def acme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install a package with an adapter: its module and its entry point."""
    (tmp_path / "acme_adapter.py").write_text(ACME)
    information = tmp_path / "acme-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: acme\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(
        "[handover.ros_adapters]\nacme = acme_adapter:join\nbroken = acme_adapter:nothing\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))


def test_our_adapters_are_named_first() -> None:
    assert ADAPTERS.names()[:4] == list(Adapter)


@pytest.mark.usefixtures("acme")
async def test_an_adapter_of_another_package_joins_the_graph() -> None:
    settings = JoinSettings(node="bridge", domain_id=98, interfaces=("127.0.0.1",))
    graph = await join(TypeStore(), settings, "acme")
    try:
        assert graph.node_name == "/acme/bridge"
        publisher = await graph.publisher("state", "std_msgs/msg/String")
        assert publisher.topic == "/acme/state"
    finally:
        await graph.close()


@pytest.mark.usefixtures("acme")
def test_an_adapter_that_cannot_be_loaded_is_named_with_its_reason() -> None:
    with pytest.raises(UnknownExtension, match=r"acme_adapter:nothing.* cannot be loaded: AttributeError"):
        load_adapter("broken")


def test_an_unknown_adapter_is_answered_with_the_known_ones() -> None:
    with pytest.raises(UnknownExtension, match='no ROS adapter "zenoh"; there are: auto, cyclone, rclpy'):
        load_adapter("zenoh")


@pytest.mark.parametrize("adapter", installed())
def test_an_installed_adapter_of_ours_can_be_loaded(adapter: Adapter) -> None:
    assert callable(load_adapter(adapter))
