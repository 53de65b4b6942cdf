"""The audit logs of all services of a data directory, or of the database that they share."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from sqlalchemy import Engine, MetaData, create_engine, inspect

from handover.database import connect
from handover.security.audit import AuditLog, AuditTables
from handover.security.audit_reading.audit_routes import AuditView, view_of
from handover.settings import Settings

_HEAD: Final = "_audit_head"
_PAGE: Final = 10_000


@dataclass(frozen=True, slots=True)
class AuditChain:
    """The audit log of a service, and its database."""

    service: str
    engine: Engine
    log: AuditLog


def chains_of(settings: Settings) -> list[AuditChain]:
    """Return the audit logs by service. Raises `UsageError` if a shared database cannot be opened."""
    if settings.database_url:
        return _chains_in(connect(settings.database("audit"), is_own=False))
    files = sorted(settings.data_dir.glob("*.db"))
    chains = [chain for file in files for chain in _chains_in(_read_only(file))]
    return sorted(chains, key=lambda chain: chain.service)


def records_of(chains: list[AuditChain], names: Mapping[str, str] = MappingProxyType({})) -> list[AuditView]:
    """Return all records by time, with the `names` of subjects."""
    views: list[AuditView] = []
    for chain in chains:
        with chain.engine.connect() as connection:
            after = 0
            while page := chain.log.read(connection, after=after, limit=_PAGE):
                views += [view_of(chain.service, record, names) for record in page]
                after = page[-1].seq
    return sorted(views, key=lambda view: (view["at"], view["service"], view["seq"]))


def _read_only(file: Path) -> Engine:
    return create_engine(f"sqlite:///file:{file.absolute()}?mode=ro&uri=true")


def _chains_in(engine: Engine) -> list[AuditChain]:
    inspector = inspect(engine)
    tables = set(inspector.get_table_names())
    components = sorted(name.removesuffix(_HEAD) for name in tables if name.endswith(_HEAD))

    def log_of(name: str) -> AuditLog:
        columns = {column["name"] for column in inspector.get_columns(f"{name}_audit")}
        has_aliases, has_intents = f"{name}_audit_alias" in tables, "intent" in columns
        return AuditLog(AuditTables(MetaData(), name, has_aliases=has_aliases, has_intents=has_intents))

    return [AuditChain(name.replace("_", "-"), engine, log_of(name)) for name in components]
