"""The store of study conditions, so that they apply at once after a restart.

A condition that is removed is erased: SQLite overwrites its row and empties the journal.
"""

from collections.abc import Mapping

from sqlalchemy import Boolean, Column, Engine, MetaData, String, Table, delete, insert, select

from handover.database import purge_log
from handover.database.migrations import migrate
from handover_gloves.people.study_conditions import StudyCondition

VERSION = 1

_meta = MetaData()
_conditions = Table(
    "controller_study_conditions",
    _meta,
    Column("session", String(64), primary_key=True),
    Column("participant", String(200), nullable=False),
    Column("glove", String(200)),
    Column("person", String(200)),
    Column("own", Boolean),
)


class StudyConditionStore:
    """Study conditions in the database; every method blocks on the database."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        migrate(engine, _meta, component="controller_study_conditions", version=VERSION)

    def load(self) -> dict[str, StudyCondition]:
        """Return the conditions by session."""
        with self._engine.connect() as connection:
            rows = connection.execute(select(_conditions)).all()
        return {row.session: StudyCondition(row.participant, row.glove, row.person, row.own) for row in rows}

    def replace(self, conditions: Mapping[str, StudyCondition]) -> None:
        """Write `conditions` in place of all stored ones, and erase those."""
        is_sqlite = self._engine.dialect.name == "sqlite"
        with self._engine.connect() as connection:
            if is_sqlite:
                connection.exec_driver_sql("PRAGMA secure_delete=ON")
            connection.execute(delete(_conditions))
            for session, condition in conditions.items():
                connection.execute(
                    insert(_conditions).values(
                        session=session,
                        participant=condition.participant,
                        glove=condition.glove,
                        person=condition.person,
                        own=condition.own,
                    )
                )
            connection.commit()
        purge_log(self._engine)
