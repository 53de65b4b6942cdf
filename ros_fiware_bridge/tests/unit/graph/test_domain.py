import pytest

from handover_ros.errors import AdapterUnavailable, BadName
from handover_ros.graph.cyclone import domain
from handover_ros.graph.cyclone.domain import DomainSettings
from handover_ros.graph.joining import JoinSettings, join
from handover_ros.types.type_store import TypeStore

pytest.importorskip("cyclonedds")


def test_by_default_the_network_and_loopback_are_used() -> None:
    first, without_network = DomainSettings().configurations()
    assert 'autodetermine="true"/>' in first
    assert 'address="127.0.0.1" priority="0" multicast="false"/>' in first
    assert "autodetermine" not in without_network
    for one in (first, without_network):
        assert '<Peer Address="127.0.0.1"/>' in one


def test_interfaces_and_peers_are_quoted() -> None:
    settings = DomainSettings(
        interfaces=("eth1", "10.0.0.7", "lo"), peers=('192.168.0.9"/><x',), multicast=False
    )
    (one,) = settings.configurations()
    assert '<NetworkInterface name="eth1" multicast="false"/>' in one
    assert '<NetworkInterface address="10.0.0.7" multicast="false"/>' in one
    assert "<x" not in one


@pytest.mark.parametrize("number", [-1, 233])
def test_a_domain_id_out_of_range_is_refused(number: int) -> None:
    with pytest.raises(AdapterUnavailable, match="use a number from 0 to 232"):
        domain.enter(DomainSettings(number))


def test_a_missing_interface_is_named() -> None:
    with pytest.raises(
        AdapterUnavailable, match="cannot be opened on eth99; check the names of the interfaces"
    ):
        domain.enter(DomainSettings(97, ("eth99",)))


async def test_an_invalid_node_name_is_refused() -> None:
    with pytest.raises(BadName):
        await join(TypeStore(), JoinSettings(node="the bridge"))
    with pytest.raises(BadName):
        await join(TypeStore(), JoinSettings(namespace="cell"))


async def test_graphs_with_equal_network_settings_share_a_domain() -> None:
    settings = JoinSettings(domain_id=99, interfaces=("127.0.0.1",))
    one = await join(TypeStore(), settings)
    other = await join(TypeStore(), settings)
    with pytest.raises(AdapterUnavailable, match="with other settings"):
        await join(TypeStore(), JoinSettings(domain_id=99, interfaces=("lo",)))
    await one.close()
    assert any(node.ours for node in other.nodes())
    await other.close()
    again = await join(TypeStore(), JoinSettings(domain_id=99, interfaces=("lo",)))
    await again.close()
