"""The tables of accounts. Only hashes of passwords and tokens are stored."""

from typing import Final

from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    Float,
    Integer,
    MetaData,
    RowMapping,
    String,
    Table,
    Text,
    UniqueConstraint,
    select,
)

from handover.security.audit import AuditTables
from handover.security.secret_tokens import is_secret_token, token_hash

VERSION: Final = 3

metadata = MetaData()

state = Table(
    "accounts_state",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("revision", BigInteger, nullable=False),
)
"""One row; a change locks it, so that changes are ordered, and their revocations numbered in that order."""

users = Table(
    "accounts_user",
    metadata,
    Column("subject", String(64), primary_key=True),
    Column("name", String(64), nullable=False),
    Column("name_key", String(256), nullable=False, unique=True),
    Column("person", String(300)),
    Column("password_hash", String(300)),
    Column("created_s", Float, nullable=False),
    Column("password_changed_s", Float, nullable=False),
)
grants = Table(
    "accounts_grant",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("subject", String(64), nullable=False, index=True),
    Column("role", String(32), nullable=False),
    Column("resource", String(300), nullable=False),
    Column("created_s", Float, nullable=False),
    UniqueConstraint("subject", "role", "resource", name="accounts_grant_once"),
)
sessions = Table(
    "accounts_session",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("token_hash", String(64), nullable=False, unique=True),
    Column("subject", String(64), nullable=False, index=True),
    Column("method", String(32), nullable=False),
    Column("address", String(64), nullable=False),
    Column("device", String(300), nullable=False),
    Column("created_s", Float, nullable=False),
    Column("seen_s", Float, nullable=False),
)
places = Table(
    "accounts_place",
    metadata,
    Column("subject", String(64), primary_key=True),
    Column("address", String(64), primary_key=True),
    Column("seen_s", Float, nullable=False),
)
"""Addresses from which a user has signed in."""

tokens = Table(
    "accounts_token",
    metadata,
    Column("subject", String(64), primary_key=True),
    Column("kind", String(16), nullable=False),
    Column("name", String(64), nullable=False),
    Column("token_hash", String(64), nullable=False, unique=True),
    Column("created_s", Float, nullable=False),
    Column("expires_s", Float),
    Column("used_s", Float),
)
links = Table(
    "accounts_link",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("token_hash", String(64), nullable=False, unique=True),
    Column("purpose", String(16), nullable=False),
    Column("name", String(64)),
    Column("subject", String(64), index=True),
    Column("grants", Text, nullable=False),
    Column("created_s", Float, nullable=False),
    Column("expires_s", Float, nullable=False),
)
"""Links that were not used yet."""

identities = Table(
    "accounts_identity",
    metadata,
    Column("issuer", String(300), primary_key=True),
    Column("provider_subject", String(255), primary_key=True),
    Column("subject", String(64), nullable=False, unique=True),
)
"""Users who sign in at an OpenID Connect provider."""

provider_sign_ins = Table(
    "accounts_provider_sign_in",
    metadata,
    Column("secret_hash", String(64), primary_key=True),
    Column("state", String(64), nullable=False),
    Column("nonce", String(64), nullable=False),
    Column("verifier", String(128), nullable=False),
    Column("redirect_uri", String(1000), nullable=False),
    Column("created_s", Float, nullable=False),
)
"""Sign-ins at the provider that are under way."""

provider_sessions = Table(
    "accounts_provider_session",
    metadata,
    Column("session", String(64), primary_key=True),
    Column("id_token", Text, nullable=False),
)
provider_grants = Table(
    "accounts_provider_grant",
    metadata,
    Column("grant_id", String(64), primary_key=True),
)
"""The grants that came from the provider, and follow it."""

stations = Table(
    "accounts_station",
    metadata,
    Column("subject", String(64), primary_key=True),
    Column("gloves", Text, nullable=False),
    Column("leave_after_s", Float, nullable=False),
)
"""Users without a password that are stations; `gloves` is a list of names as JSON."""

joins = Table(
    "accounts_join",
    metadata,
    Column("station", String(64), primary_key=True),
    Column("subject", String(64), nullable=False, index=True),
    Column("method", String(32), nullable=False),
    Column("joined_s", Float, nullable=False),
    Column("seen_s", Float, nullable=False),
)
"""Who has joined which station."""

identifiers = Table(
    "accounts_identifier",
    metadata,
    Column("kind", String(16), primary_key=True),
    Column("value_hash", String(64), primary_key=True),
    Column("subject", String(64), nullable=False, index=True),
)
"""By what people are recognized at stations."""

requests = Table(
    "accounts_request",
    metadata,
    Column("id", String(64), primary_key=True),
    Column("name", String(64), nullable=False),
    Column("contact", String(200), nullable=False),
    Column("note", Text, nullable=False),
    Column("created_s", Float, nullable=False),
)
revocations = Table(
    "accounts_revocation",
    metadata,
    Column("number", BigInteger().with_variant(Integer, "sqlite"), primary_key=True, autoincrement=False),
    Column("name", String(64), nullable=False),
    Column("at_s", Float, nullable=False),
)
audit = AuditTables(metadata, "accounts")


def row_of_token(connection: Connection, table: Table, token: str) -> RowMapping | None:
    """Return the row of `table` that has the hash of a secret token; it may have expired."""
    if not is_secret_token(token):
        return None
    query = select(table).where(table.c.token_hash == token_hash(token))
    return connection.execute(query).mappings().first()
