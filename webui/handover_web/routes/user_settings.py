"""Settings that each user keeps on the server: the arrangement of panels, mappings of input devices.

A setting is a JSON object by name. The page defines what it contains; nothing here grants a right.
"""

import asyncio
import threading
from typing import Annotated, Any, Final

import orjson
from fastapi import Body, FastAPI
from fastapi import Path as InPath
from sqlalchemy import Column, Engine, MetaData, String, Table, Text, delete, func, insert, select

from handover.errors import Problem
from handover.http.body_limit import max_body
from handover.security.caller import Caller
from handover.security.guard import require_signed_in

MAX_BYTES: Final = 32 * 1024
MAX_SETTINGS: Final = 64
"""Settings of one user."""

_meta = MetaData()
_settings = Table(
    "webui_user_settings",
    _meta,
    Column("subject", String(200), primary_key=True),
    Column("name", String(64), primary_key=True),
    Column("value", Text, nullable=False),
)

Name = Annotated[str, InPath(pattern=r"^[a-z][A-Za-z0-9.-]{0,63}$")]
User = Annotated[Caller, require_signed_in()]


class UserSettings:
    """The settings of all users, by subject and name."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._preparing = threading.Lock()
        self._is_prepared = False

    def read(self, subject: str, name: str) -> dict[str, Any]:
        """Return a setting; empty if it was never written."""
        self._prepare()
        chosen = (_settings.c.subject == subject) & (_settings.c.name == name)
        with self._engine.connect() as connection:
            value = connection.execute(select(_settings.c.value).where(chosen)).scalar()
        stored: dict[str, Any] = {} if value is None else orjson.loads(value)
        return stored

    def delete(self, subject: str) -> None:
        """Delete all settings of a user who was deleted."""
        self._prepare()
        with self._engine.begin() as connection:
            connection.execute(delete(_settings).where(_settings.c.subject == subject))

    def write(self, subject: str, name: str, value: dict[str, Any]) -> None:
        """Write a setting; it is durable then. Raises `Problem` 409 for too many."""
        self._prepare()
        mine = _settings.c.subject == subject
        with self._engine.begin() as connection:
            connection.execute(delete(_settings).where(mine & (_settings.c.name == name)))
            count = connection.execute(select(func.count()).select_from(_settings).where(mine)).scalar() or 0
            if count >= MAX_SETTINGS:
                raise Problem(409, "Too many settings", f"a user has at most {MAX_SETTINGS} settings")
            row = {"subject": subject, "name": name, "value": orjson.dumps(value).decode()}
            connection.execute(insert(_settings).values(row))

    def _prepare(self) -> None:
        with self._preparing:
            if not self._is_prepared:
                _meta.create_all(self._engine)
                self._is_prepared = True


def add_user_settings(app: FastAPI, settings: UserSettings) -> None:
    """Add the routes."""

    @app.get("/api/user-settings/{name}", tags=["session"])
    async def read(name: Name, caller: User) -> dict[str, Any]:
        """Return a setting of the user; an empty object if it was never written."""
        return await asyncio.to_thread(settings.read, caller.subject, name)

    @app.put("/api/user-settings/{name}", status_code=204, tags=["session"])
    @max_body(MAX_BYTES)
    async def write(name: Name, caller: User, value: Annotated[dict[str, Any], Body()]) -> None:
        """Replace a setting of the user."""
        await asyncio.to_thread(settings.write, caller.subject, name, value)
