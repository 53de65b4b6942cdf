"""Several page servers: each subscribes for itself, so that all of them are notified."""

from typing import Any

import pytest

from handover_web.settings import WebuiSettings
from handover_web.sources.broker_entities import BrokerEntities


def subscription_of(**settings: Any) -> dict[str, Any]:
    made = WebuiSettings.load(**settings)
    entities = BrokerEntities(made, broker=None, handlers=(), services=None)  # type: ignore[arg-type]
    return entities._new_subscription()


def test_one_page_server_keeps_one_subscription_for_ever(tmp_path: Any) -> None:
    made = subscription_of(data_dir=tmp_path)
    assert made["id"] == "urn:ngsi-ld:Subscription:demo:webui"
    assert "expiresAt" not in made


def test_each_replica_has_a_subscription_that_ends_after_it(tmp_path: Any) -> None:
    first, second = (
        subscription_of(data_dir=tmp_path, instance=name, webui_url=f"https://{name}:54400")
        for name in ("webui-0", "webui-1")
    )
    assert first["id"] != second["id"]
    assert first["notification"]["endpoint"]["uri"] != second["notification"]["endpoint"]["uri"]
    assert first["expiresAt"].endswith("Z")


@pytest.mark.parametrize("name", ["a b", "x" * 64, "ä"])
def test_the_name_of_a_replica_is_part_of_an_id(name: str) -> None:
    with pytest.raises(Exception, match="HANDOVER_INSTANCE"):
        WebuiSettings.load(instance=name)
