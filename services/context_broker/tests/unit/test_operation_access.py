"""Every operation of the broker has an access class."""

from pathlib import Path

from handover_broker.access.operation_access import OperationAccess, access_of, has_access_class
from handover_broker.app import operations_of
from handover_broker.settings import BrokerSettings


def test_every_operation_is_classified(tmp_path: Path) -> None:
    for operation in operations_of(BrokerSettings(data_dir=tmp_path)):
        assert has_access_class(operation), f"add {operation.name} to operation_access.py"


def test_only_reading_operations_ask_for_reading(tmp_path: Path) -> None:
    reading = {OperationAccess.READ_ENTITIES, OperationAccess.READ_TENANT}
    for operation in operations_of(BrokerSettings(data_dir=tmp_path)):
        if access_of(operation) in reading:
            is_query = "query" in operation.path or "entityMaps" in operation.path
            assert operation.method == "GET" or is_query, operation.title
