"""The schema of the database: its tables are created, or brought to the version of this release."""

import time
from typing import Final

from sqlalchemy import Connection, Engine, inspect

from handover.database.migrations import migrate
from handover_devices.storage import partitions
from handover_devices.storage.tables import meta

VERSION: Final = 7
COMPONENT: Final = "device_gateway"


def prepare(engine: Engine) -> None:
    """Create the tables, or bring them to this version; create the partitions of the next days."""
    migrate(
        engine,
        meta,
        component=COMPONENT,
        version=VERSION,
        steps={
            1: meta.create_all,
            2: _add_certificates,
            3: _partition_values,
            4: meta.create_all,
            5: meta.create_all,
            6: _add_reason_messages,
        },
    )
    with engine.begin() as connection:
        partitions.create_ahead(connection, int(time.time() * 1e6))


def _add_certificates(connection: Connection) -> None:
    connection.exec_driver_sql("ALTER TABLE device ADD COLUMN certificate_sha256 VARCHAR(64)")
    connection.exec_driver_sql("ALTER TABLE device ADD COLUMN certificate_end_us BIGINT")


def _add_reason_messages(connection: Connection) -> None:
    columns = {column["name"] for column in inspect(connection).get_columns("device_command")}
    if "reason_message" not in columns:  # a step before may have made the table
        connection.exec_driver_sql("ALTER TABLE device_command ADD COLUMN reason_message TEXT")


def _partition_values(connection: Connection) -> None:
    partitions.partition_existing(connection)
    meta.create_all(connection)
