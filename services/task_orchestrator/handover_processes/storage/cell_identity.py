"""The identity of the cell: random, made once for each database, so that replicas and restarts share it."""

import secrets

from sqlalchemy import Column, Engine, MetaData, String, Table, insert, select

from handover.database import migrations

_meta = MetaData()
_identity = Table("orchestrator_cell", _meta, Column("identity", String(32), primary_key=True))
_VERSION = 1


def identity_of(engine: Engine) -> str:
    """Return the identity of the cell whose processes are in this database; make it at the first start."""
    migrations.migrate(engine, _meta, component="orchestrator_cell", version=_VERSION)
    with engine.begin() as connection:
        stored: str | None = connection.scalar(select(_identity.c.identity))
        if stored is None:
            stored = secrets.token_hex(16)
            connection.execute(insert(_identity).values(identity=stored))
        return stored
