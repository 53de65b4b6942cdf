"""The audit log of a service: its records, tables and chain."""

from handover.security.audit.log import MAX_TEXT_CHARACTERS, AuditLog
from handover.security.audit.records import (
    GENESIS,
    INTENDED,
    AuditFilter,
    AuditRecord,
    Verification,
    record_hash,
)
from handover.security.audit.tables import AuditTables

__all__ = [
    "GENESIS",
    "INTENDED",
    "MAX_TEXT_CHARACTERS",
    "AuditFilter",
    "AuditLog",
    "AuditRecord",
    "AuditTables",
    "Verification",
    "record_hash",
]
