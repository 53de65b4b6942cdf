"""Settings: read from environment variables `HANDOVER_…` and from `.env`; every setting has a default.

Secrets can also be files: in the directory `HANDOVER_SECRETS_DIR`, the file with the name of a setting has
its value, unless the environment has a value that is not empty.

A service subclasses `Settings` in its `settings.py`; `handover settings` prints all settings with the source
of each value.
"""

import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from ipaddress import ip_network
from pathlib import Path
from typing import Any, ClassVar, Literal, Self
from urllib.parse import quote, urlsplit

from dotenv import dotenv_values
from pydantic import Field, SecretStr, ValidationError, field_validator, model_validator
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from handover.errors import UsageError
from handover.network.outbound_policy import OutboundPolicy, is_loopback
from handover.renamed_modules import moved_file
from handover.setting_sources import (
    ENV_FILE,
    HEADERS_OF_REQUESTS,
    PREFIX,
    SECRETS_DIR,
    MaybeNames,
    MaybePath,
    Names,
    SecretFiles,
    headers_in,
    secret_file,
)

__all__ = [
    "COMPONENTS_FILE",
    "DEFAULT_PORTS",
    "ENV_FILE",
    "HEADERS_OF_REQUESTS",
    "LIFELINE",
    "PASSWORD_IN_URL",
    "PREFIX",
    "PUBLIC_KEYS_FILE",
    "RESTARTED",
    "SECRETS_DIR",
    "SERVICE_TOKENS_FOLDER",
    "SIGNING_KEYS_FILE",
    "STARS",
    "MaybeNames",
    "MaybePath",
    "Names",
    "Origin",
    "Settings",
    "Source",
    "headers_in",
    "origins",
    "secret_file",
]

LIFELINE = f"{PREFIX}LIFELINE"
"""Set by the launcher: the service ends when its standard input closes, so that no orphan remains."""
RESTARTED = f"{PREFIX}RESTARTED"
"""Set by the watchdog for a service that it has restarted: nothing that moves is continued by itself."""
COMPONENTS_FILE = "components"
"""In the security directory: the endpoints of registered components, each with its name."""
PUBLIC_KEYS_FILE = "public-keys.json"
"""In the security directory; it exists as soon as there are accounts."""
SERVICE_TOKENS_FOLDER = "service-tokens"
"""In the security directory: a file for each service."""
SIGNING_KEYS_FILE = "accounts-keys.json"
"""In the data directory of accounts, which alone reads it."""
DEFAULT_PORTS = (54100, 54200, 54210, 54220, 54230, 54240, 54270, 54280, 54400)
"""The REST ports of our services, where no setting names others."""
_OWN_PORT = re.compile(rf"{PREFIX}[A-Z_]+_PORT$")
STARS = "********"
PASSWORD_IN_URL = re.compile(r"(://[^:/@\s]*:)[^@\s]*@")
USER_WITHOUT_PASSWORD = re.compile(r"^([^:/@\s]+://[^:/@\s]+)@")


class Settings(BaseSettings):
    """The settings that all components have."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, env_file=ENV_FILE, env_file_encoding="utf-8", extra="ignore", frozen=True
    )
    removed: ClassVar[Mapping[str, str]] = {}
    """Former settings, each with what holds instead; until 1.0, one that is still set raises a warning."""

    factory: str = Field("demo", pattern=r"^[A-Za-z0-9_.-]+$", description="the factory part of entity ids")
    host: str = Field("127.0.0.1", description="the address that servers listen on")
    instance: str = Field(
        "",
        pattern=r"^[A-Za-z0-9_.-]{0,63}$",
        description="the name of this replica, where several of one service run: each subscribes for itself",
    )
    data_dir: Path = Field(Path(".handover"), description="the directory of all persistent data")
    standby: bool = Field(
        False,
        description="a service whose database another process holds waits for the end of that process; "
        "otherwise it ends with exit code 2 and names the holder",
    )
    broker_port: int = Field(1026, ge=1, le=65535, description="the port of the embedded broker")
    broker_url: str = Field(
        "http://127.0.0.1:1026",
        description="the NGSI-LD broker, without /ngsi-ld/v1; the embedded one of this machine if absent",
    )
    broker_token_file: MaybePath = Field(
        None,
        description="the file of a token for a broker of others, or the proxy before it, sent as "
        "Authorization: Bearer; it may be replaced at any time",
    )
    broker_headers: SecretStr | None = Field(
        None,
        description='headers that a broker of others wants, as a JSON object: {"X-Auth-Token": "…"}',
    )
    broker_oauth_url: str | None = Field(
        None,
        description="the token endpoint of OAuth 2.0 client credentials for a broker of others (Keyrock: "
        "/oauth2/token, Keycloak: /realms/NAME/protocol/openid-connect/token)",
    )
    broker_oauth_client: str | None = Field(None, description="the id of the client at that endpoint")
    broker_oauth_secret: SecretStr | None = Field(None, description="the secret of that client")
    broker_oauth_scope: str | None = Field(
        None, description="the scope to ask for, if the endpoint needs one"
    )
    orchestrator_port: int = Field(54200, ge=0, le=65535, description="the port the orchestrator listens on")
    orchestrator_url: str | None = Field(
        None, description="where the broker and others reach the orchestrator; host and port if absent"
    )
    device_leases: Literal["auto", "required", "off"] = Field(
        "auto",
        description="whether a performer needs the lease of a Device, which the orchestrator grants: "
        "required (always), auto (unless no orchestrator listens and none ever granted it one), off (a cell "
        "without our orchestrator, with one performer of each Device)",
    )
    lease_urls: Names = Field(
        (),
        description="addresses of the orchestrators of a database, with commas, where a standby has another "
        "address than HANDOVER_ORCHESTRATOR_URL: a performer asks each for leases until one answers",
    )
    broker_tenant: str | None = Field(None, description="NGSILD-Tenant to work in, if any")
    context_url: str = Field(
        "https://w3id.org/handover/context.jsonld",
        description="the @context sent in Link headers; for a broker that must fetch it, "
        "the address of /context.jsonld on any of our services",
    )
    database_url: str | None = Field(
        None, description="SQLAlchemy URL of the database; a SQLite file in the data directory if absent"
    )
    specification_url: str | None = Field(
        None,
        description="SQLAlchemy URL of the specification database, which has what a person is shown for the "
        "Tasks that do not say it themselves; specifications.db in the data directory if absent",
    )
    retention_h: float = Field(
        24.0,
        ge=0,
        description="an ended process and its Tasks are deleted from the broker after so many hours; "
        "the orchestrator keeps their history; 0: never",
    )
    audit_retention_days: float = Field(
        730.0, ge=0, description="audit records are deleted after so many days; 0: never"
    )
    notification_key: SecretStr | None = Field(
        None,
        description="the key that the broker sends with each notification; "
        "by default random and stored in the data directory",
    )
    allowed_hosts: Names = Field(
        (),
        description="further host names of the servers, separated by commas; loopback, numeric "
        "addresses and the host names in HANDOVER_*_URL are always accepted",
    )
    allowed_origins: Names = Field(
        (),
        description="origins (https://panel.example) whose requests are accepted besides each server's own, "
        "with commas: for a proxy that changes Host, and for WebSockets; CORS headers are not sent",
    )
    tls_certificate: MaybePath = Field(
        None,
        description="the certificate of this server with its chain (PEM); with it servers and the glove port "
        "speak TLS. `handover secure` makes one; a changed file is used for new connections",
    )
    public_tls_certificate: MaybePath = Field(
        None,
        description="a second certificate of this server (PEM, with its chain), of a public authority: "
        "clients that ask for a name in it get it, all others that of `tls_certificate`, which programs of "
        "the cell verify",
    )
    public_tls_key: MaybePath = Field(
        None, description="the private key of that certificate (PEM); by default in the same file"
    )
    tls_key: MaybePath = Field(
        None, description="the private key of that certificate (PEM); by default in the same file"
    )
    tls_authority: MaybePath = Field(
        None,
        description="authorities (PEM) that clients of our services trust besides those of the system",
    )
    tls_proxy_url: str | None = Field(
        None,
        description="the https address of a proxy that does TLS for this server; with it a server may listen "
        "beyond loopback without a certificate of its own",
    )
    trusted_proxies: Names = Field(
        (),
        description="addresses and networks of proxies, comma-separated, whose X-Forwarded-For and "
        "X-Forwarded-Proto name the client and its scheme; from others these headers do not count",
    )
    component_url: str | None = Field(
        None,
        description="where the broker reaches a component of others, in the file of `handover component "
        "add`; host and port if absent",
    )
    tls_handshake_timeout_s: float = Field(10.0, gt=0, description="timeout for a TLS handshake, in seconds")
    outbound_allow: str = Field(
        "",
        description="hosts, endpoints and networks, comma-separated (mes, 127.0.0.1:1883, 10.0.0.0/8), to "
        "which a service may connect, besides public ones and our own services, where a client names the "
        "address (notifications, context sources, @contexts, BPMN files). While it listens on loopback only, "
        "private networks, and without accounts its own machine, are open without it",
    )
    accounts_port: int = Field(54230, ge=1, le=65535, description="REST port of accounts")
    accounts_url: str | None = Field(
        None, description="the URL of accounts for others; by default http://host:port"
    )
    security_dir: MaybePath = Field(
        None,
        description="the directory of the public keys of accounts and of the services' tokens; "
        "`security` in the data directory if absent",
    )
    service_token: SecretStr | None = Field(
        None,
        description="the token with which a service identifies itself to accounts; by default its file",
    )
    service_token_file: MaybePath = Field(
        None,
        description="the file of that token; by default `service-tokens/SERVICE` in the security directory",
    )
    authority_dir: MaybePath = Field(
        None,
        description="the directory of the local certificate authority of `handover secure`; `tls` in the "
        "data directory if absent",
    )
    http_header_timeout_s: float = Field(
        10.0, gt=0, description="timeout for the head of a request, in seconds"
    )
    http_body_timeout_s: float = Field(
        15.0, gt=0, description="timeout for the next bytes of a request's body, in seconds"
    )
    http_min_body_bytes_per_s: float = Field(
        500.0, ge=0, description="minimum average rate of a body after that time"
    )
    http_send_timeout_s: float = Field(
        60.0, gt=0, description="timeout for a client that does not read its response, in seconds"
    )
    http_max_connections: int = Field(
        4000, ge=16, description="maximum connections to a server; the limit of open files may reduce it"
    )
    http_max_unfinished_per_address: int = Field(
        100, ge=1, description="maximum connections of one address with incomplete requests"
    )
    http_max_websockets: int = Field(
        1000,
        ge=1,
        description="maximum WebSockets of a server; a tenth, at most 50, is kept for what moves or changes "
        "something and for services",
    )
    http_max_websockets_per_session: int = Field(
        64, ge=1, description="maximum WebSockets of a session or a token at one server"
    )
    http_max_websockets_per_person: int = Field(
        128, ge=1, description="maximum WebSockets of a person at one server"
    )
    database_password: SecretStr | None = Field(
        None, description="the password for database URLs that name a user but no password"
    )
    secrets_dir: MaybePath = Field(
        None,
        description="a directory whose files, named like settings, hold secrets; made by `handover secrets`",
    )
    extra_services: MaybeNames = Field(
        None,
        description="the services of other packages that `handover up` starts, with commas; all that are "
        "installed if absent",
    )
    reconcile_s: float = Field(
        5.0, gt=0, description="period of the reconciliation with the broker, in seconds"
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field("info", description="least level logged")
    log_format: Literal["text", "json"] = Field("text", description="how log lines look")

    @field_validator("*", mode="after")
    @classmethod
    def _at_its_present_place(cls, setting: Any) -> Any:
        return moved_file(setting) if isinstance(setting, Path) else setting

    @field_validator("broker_url")
    @classmethod
    def _without_trailing_slash(cls, url: str) -> str:
        if not url.startswith(("http://", "https://")):
            raise ValueError("must start with http:// or https://")
        return url.rstrip("/").removesuffix("/ngsi-ld/v1")

    @field_validator("broker_headers")
    @classmethod
    def _are_headers(cls, headers: SecretStr | None) -> SecretStr | None:
        if headers is None or not headers.get_secret_value().strip():
            return None
        headers_in(headers.get_secret_value())
        return headers

    @field_validator("broker_oauth_url")
    @classmethod
    def _is_token_endpoint(cls, url: str | None) -> str | None:
        if url and re.fullmatch(r"https?://[^/@\s]+/\S*", url) is None:
            raise ValueError(
                f'"{url}" is no address of a token endpoint; write it as https://id.example/token'
            )
        return url or None

    @field_validator("service_token")
    @classmethod
    def _is_token(cls, token: SecretStr | None) -> SecretStr | None:
        return token if token is not None and token.get_secret_value() else None

    @field_validator("tls_proxy_url")
    @classmethod
    def _is_https(cls, url: str | None) -> str | None:
        if url and re.fullmatch(r"https://[^/@\s]+/?", url) is None:
            raise ValueError(f'"{url}" is no https address; write it as https://cell-3.factory.example')
        return url or None

    @model_validator(mode="before")
    @classmethod
    def _finds_the_embedded_broker(cls, values: dict[str, Any]) -> dict[str, Any]:
        """Without another URL the broker is that of this machine, with TLS where there is a certificate."""
        if values.get("broker_url"):
            return values
        scheme = "https" if values.get("tls_certificate") else "http"
        port = values.get("broker_port") or cls.model_fields["broker_port"].default
        return {**values, "broker_url": f"{scheme}://127.0.0.1:{port}"}

    @model_validator(mode="after")
    def _has_one_token_for_the_broker(self) -> Self:
        headers = {name.lower() for name in self.other_broker_headers()}
        ways = {
            "broker_token_file": self.broker_token_file is not None,
            "broker_oauth_url": self.broker_oauth_url is not None,
            "broker_headers (Authorization)": "authorization" in headers,
        }
        used = [name for name, is_used in ways.items() if is_used]
        if len(used) > 1:
            raise ValueError(f"{' and '.join(used)} both give a token for the broker; set one of them")
        if self.broker_oauth_url and not (self.broker_oauth_client and self.broker_oauth_secret):
            raise ValueError("broker_oauth_url needs broker_oauth_client and broker_oauth_secret; set them")
        return self

    @model_validator(mode="after")
    def _has_certificate_for_key(self) -> Self:
        if self.tls_key is not None and self.tls_certificate is None:
            raise ValueError("tls_key is set without tls_certificate; set both")
        if self.public_tls_certificate is not None and self.tls_certificate is None:
            raise ValueError(
                "public_tls_certificate is set without tls_certificate, which the programs of the cell "
                "verify; set tls_certificate to the file that `handover secure` makes"
            )
        return self

    @field_validator("notification_key")
    @classmethod
    def _is_long_enough(cls, key: SecretStr | None) -> SecretStr | None:
        if key is None or not key.get_secret_value():
            return None
        if re.fullmatch(r"[\x21-\x7e]{16,200}", key.get_secret_value()) is None:
            raise ValueError("must have 16 to 200 printable ASCII characters without spaces")
        return key

    @field_validator("allowed_origins")
    @classmethod
    def _are_origins(cls, origins: tuple[str, ...]) -> tuple[str, ...]:
        for origin in origins:
            if re.fullmatch(r"https?://[^/@\s]+/?", origin) is None:
                raise ValueError(
                    f'"{origin}" is no origin; write it as https://panel.example or http://host:8080'
                )
        return origins

    @field_validator("trusted_proxies")
    @classmethod
    def _are_networks(cls, proxies: tuple[str, ...]) -> tuple[str, ...]:
        for proxy in proxies:
            try:
                ip_network(proxy)
            except ValueError:
                raise ValueError(
                    f'"{proxy}" is no address or network; write it as 127.0.0.1 or 10.0.3.0/24'
                ) from None
        return proxies

    @field_validator("outbound_allow")
    @classmethod
    def _names_hosts_and_networks(cls, allowed: str) -> str:
        OutboundPolicy.of("127.0.0.1", allowed)
        return allowed

    @classmethod
    def load(cls, **overrides: Any) -> Self:
        """Read the settings; raise `UsageError` with one line for each invalid setting."""
        _warn_of(cls.removed)
        try:
            return cls(**overrides)
        except ValidationError as error:
            raise UsageError("\n".join(_in_plain_words(error))) from None

    def entity_id(self, kind: str, name: str) -> str:
        """Return `name` as `urn:ngsi-ld:<kind>:<factory>:<name>`; a URN is returned unchanged."""
        return name if name.startswith("urn:") else f"urn:ngsi-ld:{kind}:{self.factory}:{name}"

    def other_broker_headers(self) -> dict[str, str]:
        """Return the headers that a broker of others wants."""
        return headers_in(self.broker_headers.get_secret_value()) if self.broker_headers else {}

    def url_of(self, port: int, url: str | None = None) -> str:
        """Return the address of a server on `port`: `url`, or by default host and port."""
        if url:
            return url.rstrip("/")
        scheme = "http" if self.tls_certificate is None else "https"
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)  # noqa: S104 - not bound
        return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}"

    def expects_tls(self, host: str) -> bool:
        """Return whether a server of ours on `host` is expected to speak TLS, where no URL says it."""
        if self.tls_certificate is not None:
            return True
        return self.tls_authority is not None and not is_loopback(host)

    def outbound_policy(self) -> OutboundPolicy:
        """Return which addresses the service may connect to where a client names them."""
        return OutboundPolicy.of(
            self.host,
            self.outbound_allow,
            endpoints=self._own_endpoints(),
            accounts_file=self.security_folder / PUBLIC_KEYS_FILE,
            components_file=self.security_folder / COMPONENTS_FILE,
        )

    def _own_endpoints(self) -> Iterator[tuple[str, int]]:
        """Yield host and port of our own services: those with a URL, and the ports on this machine."""
        for url in self.own_urls():
            parts = urlsplit(url)
            if parts.hostname:
                yield parts.hostname, parts.port or (443 if parts.scheme == "https" else 80)
        variables = {**dotenv_values(ENV_FILE), **os.environ}
        own = (value or "" for name, value in variables.items() if _OWN_PORT.match(name))
        ports = {int(value) for value in own if value.isdigit()}
        for port in (*DEFAULT_PORTS, *ports):
            yield from ((host, port) for host in ("127.0.0.1", "localhost", "::1"))

    @property
    def ca_files(self) -> tuple[Path, ...]:
        """The files with authorities that clients trust besides those of the system."""
        return () if self.tls_authority is None else (self.tls_authority,)

    def own_urls(self) -> Iterator[str]:
        """Yield the addresses of our servers in these settings."""
        for name in type(self).model_fields:
            url = getattr(self, name)
            if (
                name.endswith("_url")
                and name not in {"context_url", "broker_oauth_url"}
                and str(url).startswith(("http://", "https://"))
            ):
                yield url

    @property
    def accounts(self) -> str:
        """The URL of accounts."""
        return self.url_of(self.accounts_port, self.accounts_url)

    @property
    def orchestrator(self) -> str:
        """The URL of the orchestrator."""
        return self.url_of(self.orchestrator_port, self.orchestrator_url)

    @property
    def security_folder(self) -> Path:
        """The directory of public keys and service tokens."""
        return self.security_dir or self.data_dir / "security"

    def database(self, component: str) -> str:
        """Return the SQLAlchemy URL of `component`'s database."""
        if self.database_url:
            return self.with_password(self.database_url)
        return f"sqlite:///{(self.data_dir / f'{component}.db').absolute()}"

    @property
    def specifications(self) -> str:
        """The SQLAlchemy URL of the specification database."""
        if self.specification_url:
            return self.with_password(self.specification_url)
        return self.database("specifications")

    def with_password(self, url: str) -> str:
        """Return a database URL with `database_password` in it, if it names a user but no password."""
        password = self.database_password.get_secret_value() if self.database_password else ""
        return USER_WITHOUT_PASSWORD.sub(rf"\1:{quote(password, safe='')}@", url) if password else url

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,  # noqa: ARG003 - ours know the environment
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Return the sources of settings in the order of precedence."""
        return init_settings, SecretFiles(settings_cls), env_settings, dotenv_settings


_looked_for: set[str] = set()


def _warn_of(removed: Mapping[str, str]) -> None:
    """Warn once of each removed setting that the environment or `.env` still has."""
    names = {f"{PREFIX}{field}".upper(): instead for field, instead in removed.items()}
    if names.keys() <= _looked_for:
        return  # settings are loaded often, and reading `.env` takes a while
    _looked_for.update(names)
    present = {name.upper() for name in (*os.environ, *dotenv_values(ENV_FILE))}
    for name in sorted(names.keys() & present):
        warnings.warn(
            f"{name} has no effect any more: {names[name]}; remove it from the environment or {ENV_FILE}",
            FutureWarning,  # shown to users, other than DeprecationWarning
            stacklevel=3,
        )


Source = Literal["environment", "secret file", ".env", "default"]


@dataclass(frozen=True, slots=True)
class Origin:
    """One setting, its value as text and the source of the value."""

    name: str
    value: str
    origin: Source
    description: str


def origins(classes: Sequence[type[Settings]]) -> Iterator[Origin]:
    """Yield every setting of `classes` once, in order; secrets are masked."""
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
            origin: Source = "default"
            if secret_file(name) is not None:
                origin = "secret file"
            elif name in in_environment:
                origin = "environment"
            elif name in in_file:
                origin = ".env"
            yield Origin(name, "" if value is None else text, origin, info.description or "")


def _in_plain_words(error: ValidationError) -> Iterator[str]:
    for problem in error.errors():
        name = f"{PREFIX}{'_'.join(str(part) for part in problem['loc'])}".upper()
        yield f"setting {name}: {problem['msg']}; correct it in the environment or in .env"
