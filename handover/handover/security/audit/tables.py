"""The tables of an audit log."""

from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    Float,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
)


class AuditTables:
    """The tables of an audit log, whose names begin with `component`."""

    def __init__(
        self,
        metadata: MetaData,
        component: str,
        *,
        has_aliases: bool = False,
        has_names: bool = False,
        has_intents: bool = False,
    ) -> None:
        self.has_intents = has_intents
        self.records = Table(
            f"{component}_audit",
            metadata,
            Column(
                "seq", BigInteger().with_variant(Integer, "sqlite"), primary_key=True, autoincrement=False
            ),
            Column("at_ms", BigInteger, nullable=False, index=True),
            Column("subject", String(64), nullable=False, index=True),
            Column("action", String(64), nullable=False, index=True),
            Column("resource", String(400), nullable=False, index=True),
            Column("outcome", String(16), nullable=False),
            Column("method", String(32), nullable=False),
            Column("text_hash", String(64), nullable=False),
            Column("previous_hash", String(64), nullable=False),
            Column("hash", String(64), nullable=False),
        )
        if has_intents:
            self.records.append_column(Column("intent", BigInteger, nullable=True))
            Index(f"{component}_audit_of_intent", self.records.c.intent)
        self.texts = Table(
            f"{component}_audit_text",
            metadata,
            Column(
                "seq", BigInteger().with_variant(Integer, "sqlite"), primary_key=True, autoincrement=False
            ),
            Column("subject", String(64), nullable=False, index=True),
            Column("about", String(400), nullable=False, index=True),
            Column("salt", String(32), nullable=False),
            Column("text", Text, nullable=False),
        )
        self.head = Table(
            f"{component}_audit_head",
            metadata,
            Column("id", Integer, primary_key=True, autoincrement=False),
            Column("seq", BigInteger, nullable=False),
            Column("hash", String(64), nullable=False),
            Column("first_seq", BigInteger, nullable=False),
            Column("first_previous_hash", String(64), nullable=False),
            Column("changed_s", Float, nullable=False),
        )
        self.aliases: Table | None = None
        if has_aliases:
            self.aliases = Table(
                f"{component}_audit_alias",
                metadata,
                Column("name", String(400), primary_key=True),
                Column("alias", String(64), nullable=False, unique=True),
            )
        self.names: Table | None = None
        if has_names:
            self.names = Table(
                f"{component}_audit_name",
                metadata,
                Column("subject", String(64), primary_key=True),
                Column("name", String(200), nullable=False),
            )

    def add_intents(self, connection: Connection) -> None:
        """Migrate the table of a log without intents to one with them."""
        table, column = self.records.name, self.records.c.intent
        connection.exec_driver_sql(f"ALTER TABLE {table} ADD COLUMN {column.name} BIGINT")
        for index in self.records.indexes:
            if column in index.columns.values():
                index.create(connection)

    def add_names(self, connection: Connection) -> None:
        """Migrate a log to one with names; those of a version before intents have them already."""
        if self.names is not None:
            self.names.create(connection, checkfirst=True)
