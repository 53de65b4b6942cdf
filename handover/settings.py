"""Settings: one prefix, `HANDOVER_`, read from the environment and from `.env`; every one has a default.

A service adds its own by subclassing `Settings` in its `settings.py`; `handover settings` prints them all
with the place each value comes from.
"""

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from dotenv import dotenv_values
from pydantic import BeforeValidator, Field, SecretStr, ValidationError, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from handover.errors import UsageError

PREFIX = "HANDOVER_"
LIFELINE = f"{PREFIX}LIFELINE"
"""Set by the launcher: the service ends when its standard input closes, so that no orphan stays."""
ENV_FILE = ".env"
STARS = "********"
PASSWORD_IN_URL = re.compile(r"(://[^:/@\s]*:)[^@\s]*@")


MaybePath = Annotated[Path | None, BeforeValidator(lambda given: given or None)]
"""A path that may be absent, or empty, which is how a container is told nothing."""


class Settings(BaseSettings):
    """What every component shares."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, env_file=ENV_FILE, env_file_encoding="utf-8", extra="ignore", frozen=True
    )

    factory: str = Field("demo", pattern=r"^[A-Za-z0-9_.-]+$", description="the factory part of entity ids")
    host: str = Field("127.0.0.1", description="the address that servers listen on")
    data_dir: Path = Field(Path(".handover"), description="where everything that must survive is kept")
    broker_url: str = Field("http://127.0.0.1:1026", description="the NGSI-LD broker, without /ngsi-ld/v1")
    broker_tenant: str | None = Field(None, description="NGSILD-Tenant to work in, if any")
    context_url: str = Field(
        "https://w3id.org/handover/context.jsonld",
        description="the @context sent in Link headers; for a broker that must fetch it, "
        "the address of /context.jsonld on any of our services",
    )
    database_url: str | None = Field(
        None, description="SQLAlchemy URL of the database; a SQLite file in the data directory if absent"
    )
    reconcile_s: float = Field(5.0, gt=0, description="how often the broker is asked again, in seconds")
    log_level: Literal["debug", "info", "warning", "error"] = Field("info", description="least level logged")
    log_format: Literal["text", "json"] = Field("text", description="how log lines look")

    @field_validator("broker_url")
    @classmethod
    def _without_trailing_slash(cls, url: str) -> str:
        if not url.startswith(("http://", "https://")):
            raise ValueError("must start with http:// or https://")
        return url.rstrip("/").removesuffix("/ngsi-ld/v1")

    @classmethod
    def load(cls, **overrides: Any) -> Self:
        """Read the settings; raise `UsageError` with one line a wrong setting."""
        try:
            return cls(**overrides)
        except ValidationError as error:
            raise UsageError("\n".join(_in_plain_words(error))) from None

    def entity_id(self, kind: str, name: str) -> str:
        """Return `name` as `urn:ngsi-ld:<kind>:<factory>:<name>`; an id that is a URN already stays."""
        return name if name.startswith("urn:") else f"urn:ngsi-ld:{kind}:{self.factory}:{name}"

    def url_of(self, port: int, told: str | None = None) -> str:
        """Return where a server of ours on `port` is reached: as `told`, else where it listens."""
        if told:
            return told.rstrip("/")
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)  # noqa: S104 - not bound
        return f"http://{f'[{host}]' if ':' in host else host}:{port}"

    def database(self, component: str) -> str:
        """Return the SQLAlchemy URL of `component`'s database."""
        if self.database_url:
            return self.database_url
        return f"sqlite:///{(self.data_dir / f'{component}.db').absolute()}"


@dataclass(frozen=True, slots=True)
class Origin:
    """One setting, its value as text and where that value comes from."""

    name: str
    value: str
    origin: Literal["environment", ".env", "default"]
    description: str


def origins(classes: Sequence[type[Settings]]) -> Iterator[Origin]:
    """Yield every setting of `classes` once, in order; secrets are shown as stars."""
    in_file = {name.upper() for name in dotenv_values(ENV_FILE)}
    in_environment = {name.upper() for name in os.environ}
    seen: set[str] = set()
    for settings_class in classes:
        values = settings_class.load()
        for field, info in settings_class.model_fields.items():
            name = f"{PREFIX}{field}".upper()
            if name in seen:
                continue
            seen.add(name)
            value = getattr(values, field)
            text = STARS if isinstance(value, SecretStr) and value.get_secret_value() else str(value)
            text = PASSWORD_IN_URL.sub(rf"\1{STARS}@", text)
            origin: Literal["environment", ".env", "default"] = "default"
            if name in in_environment:
                origin = "environment"
            elif name in in_file:
                origin = ".env"
            yield Origin(name, "" if value is None else text, origin, info.description or "")


def _in_plain_words(error: ValidationError) -> Iterator[str]:
    for problem in error.errors():
        name = f"{PREFIX}{'_'.join(str(part) for part in problem['loc'])}".upper()
        yield f"setting {name}: {problem['msg']}; correct it in the environment or in .env"
