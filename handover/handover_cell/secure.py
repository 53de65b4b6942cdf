"""`handover secure`: TLS and accounts in one go, for this machine or for the containers of a cell.

It makes what is missing and changes nothing that is valid: the local authority, certificates, secrets, keys
and tokens of accounts, and the one-time link of the owner. The init container of `docker-compose.yml` runs it
at each start.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer

from handover.command_line import secrets
from handover.errors import UsageError
from handover.network.outbound_policy import address_of
from handover.settings import Settings
from handover.transport_security.local_authority import LocalAuthority, ServerFiles
from handover_accounts.command_line.accounts import PageSettings, service_names, set_up_accounts
from handover_accounts.settings import AccountsSettings
from handover_cell.compose_override import write_override

SERVICE_FILE = "service-token"
"""The file of the token of a service, beside its certificate."""

app = typer.Typer(help="Set up TLS and accounts; they are required beyond this machine.")

Names = Annotated[
    list[str] | None,
    typer.Option("--name", help="A host name or address under which others reach the server; repeatable."),
]
Servers = Annotated[
    list[str] | None,
    typer.Option(
        "--server",
        help="FOLDER=NAME,NAME: a certificate of its own in this folder for one server, and its token if the "
        "first name is that of a service; repeatable.",
    ),
]
Clients = Annotated[
    list[str] | None,
    typer.Option(
        "--client",
        help="FOLDER=NAME: the certificate of the authority and the token of the service NAME in the folder "
        "of a client; repeatable.",
    ),
]
Trust = Annotated[
    list[str] | None,
    typer.Option(
        "--trust", help="A folder of clients, which gets the certificate of the authority; repeatable."
    ),
]
Secrets = Annotated[
    list[str] | None,
    typer.Option(
        "--secret",
        help="FOLDER=NAME,NAME: a folder that gets a copy of these secrets of HANDOVER_SECRETS_DIR, for one "
        "reader; repeatable.",
    ),
]
Compose = Annotated[
    Path | None,
    typer.Option(
        "--compose",
        help="Make the files of the containers of this compose file in the data directory, and an override "
        "that mounts them.",
    ),
]
DataDir = Annotated[Path | None, typer.Option("--data-dir", help="The directory of all persistent data.")]


@dataclass(frozen=True, slots=True)
class Plan:
    """What to make: folders with the names of their servers, clients by folder, folders that only trust."""

    servers: tuple[tuple[Path, tuple[str, ...]], ...] = ()
    clients: tuple[tuple[Path, str], ...] = ()
    trusting: tuple[Path, ...] = ()
    secrets: tuple[tuple[Path, tuple[str, ...]], ...] = ()

    @classmethod
    def of(
        cls,
        servers: Sequence[str] | None = None,
        clients: Sequence[str] | None = None,
        trusting: Sequence[str] | None = None,
        secrets: Sequence[str] | None = None,
    ) -> "Plan":
        """Return the plan in the options of the command; raise `UsageError`."""
        return cls(
            tuple(_folder_and_names(server, "--server FOLDER=NAME,NAME") for server in servers or ()),
            tuple(
                (folder, names[0])
                for folder, names in (
                    _folder_and_names(client, "--client FOLDER=NAME") for client in clients or ()
                )
            ),
            tuple(map(Path, trusting or ())),
            tuple(_folder_and_names(secret, "--secret FOLDER=NAME,NAME") for secret in secrets or ()),
        )

    def token_files(self) -> dict[str, Path]:
        """Return the files of the tokens of services that are beside their certificates."""
        services = set(service_names())
        if unknown := [name for _, name in self.clients if name not in services]:
            raise UsageError(
                f"{', '.join(unknown)} is no service of Handover, so `secure --client` makes no token for "
                "it. For a component of your own: handover component add NAME --device ID"
            )
        named = ((names[0], folder) for folder, names in self.servers if names)
        return {
            name: folder / SERVICE_FILE
            for name, folder in (*named, *((name, folder) for folder, name in self.clients))
            if name in services
        }


@app.callback(invoke_without_command=True)
def secure(  # noqa: PLR0917 - the options of the command
    context: typer.Context,
    name: Names = None,
    server: Servers = None,
    client: Clients = None,
    trust: Trust = None,
    secret: Secrets = None,
    compose: Compose = None,
    data_dir: DataDir = None,
) -> None:
    """Make what is missing, and print what to do next; valid certificates and tokens stay as they are."""
    if context.invoked_subcommand is not None:
        return
    settings = _settings(data_dir)
    if compose is not None:

        def make_for_containers(words: Sequence[str], environment: Mapping[str, str]) -> None:
            _make_for_containers(words, environment, name or ())

        write_override(compose, settings.data_dir, name or (), make_for_containers)
        return
    authority = LocalAuthority(_authority_folder(settings))
    plan = Plan.of(server, client, trust, secret)
    if plan.servers:
        make(authority, plan, settings)
        return
    folder = authority.folder / "server"
    names = tuple(dict.fromkeys((*(name or authority.names_of(folder)), *settings.allowed_hosts)))
    plan = replace(plan, servers=((folder, names),))
    (issued,) = make(authority, plan, settings, hosts=_host_names(names))
    _print_next(issued, _host_names(names))


def make(
    authority: LocalAuthority, plan: Plan, settings: AccountsSettings, hosts: Sequence[str] = ()
) -> list[ServerFiles]:
    """Make certificates, secrets and accounts; say what was made. `hosts` are names of the page."""
    made = _certify(authority, plan)
    if settings.secrets_dir is not None:
        secrets.make_in(settings.secrets_dir)
        secrets.give(settings.secrets_dir, plan.secrets)
    # Last, since it ends local mode: a service that sees the keys needs its token.
    page = PageSettings.load(
        tls_certificate=settings.tls_certificate or made[0].certificate,
        allowed_hosts=settings.allowed_hosts or tuple(hosts),
    )
    set_up_accounts(settings, page, token_files=plan.token_files() or None)
    return made


def _certify(authority: LocalAuthority, plan: Plan) -> list[ServerFiles]:
    """Make the certificates of a plan, and say so."""
    made = [authority.secure(folder, names) for folder, names in plan.servers]
    for folder in (*plan.trusting, *(folder for folder, _ in plan.clients)):
        authority.trust(folder)
    _print_authority(authority)
    for server in made:
        _print_server(server)
    return made


def _make_for_containers(words: Sequence[str], environment: Mapping[str, str], names: Sequence[str]) -> None:
    """Do what the init container does with the arguments `words`, with folders of this machine."""
    options: dict[str, list[str]] = {"--server": [], "--client": [], "--trust": [], "--secret": []}
    for word in words:
        option, _, value = word.partition("=")
        if option in options:
            options[option].append(value)
    settings = AccountsSettings.load(
        data_dir=Path(environment["HANDOVER_DATA_DIR"]),
        security_dir=Path(environment["HANDOVER_SECURITY_DIR"]),
        authority_dir=Path(environment["HANDOVER_AUTHORITY_DIR"]),
        secrets_dir=Path(environment["HANDOVER_SECRETS_DIR"]),
    )
    plan = Plan.of(*options.values())
    make(LocalAuthority(_authority_folder(settings)), plan, settings, hosts=_host_names(names))


@app.command()
def certificates(server: Servers = None, data_dir: DataDir = None) -> None:
    """Make the authority and certificates alone, such as that of the database which accounts need."""
    plan = Plan.of(server)
    if not plan.servers:
        raise UsageError("name the folder and the server of a certificate: --server FOLDER=NAME,NAME")
    _certify(LocalAuthority(_authority_folder(_settings(data_dir))), plan)


@app.command()
def renew(data_dir: DataDir = None) -> None:
    """Make all certificates again, with new keys; running servers load them within seconds."""
    folder = _authority_folder(_settings(data_dir))
    if not (folder / "authority.pem").exists():
        raise UsageError(f"there is no authority in {folder}; make it with: handover secure --name HOST")
    authority = LocalAuthority(folder)
    made = authority.renew()
    _print_authority(authority)
    for server in made:
        _print_server(server)


def _settings(data_dir: Path | None) -> AccountsSettings:
    return AccountsSettings.load(**({} if data_dir is None else {"data_dir": data_dir}))


def _authority_folder(settings: Settings) -> Path:
    return (settings.authority_dir or settings.data_dir / "tls").absolute()


def _folder_and_names(text: str, form: str) -> tuple[Path, tuple[str, ...]]:
    folder, _, names = text.partition("=")
    parts = tuple(name.strip() for name in names.split(",") if name.strip())
    if not folder or not parts:
        raise UsageError(f'"{text}" names no folder with a name; write it as {form}')
    return Path(folder), parts


def _host_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names that are no addresses: a server has to be given those."""
    return tuple(name for name in names if address_of(name.strip("[]")) is None)


def _print_authority(authority: LocalAuthority) -> None:
    state = "created" if authority.is_new else "exists"
    expires = authority.certificate.not_valid_after_utc
    print(f"authority: {state} in {authority.path}, valid until {expires:%Y-%m-%d}")


def _print_server(server: ServerFiles) -> None:
    state = "created" if server.is_new else "exists"
    names = ", ".join(server.names)
    print(f"certificate: {state} in {server.certificate}, valid until {server.expires:%Y-%m-%d}, for {names}")


def _print_next(server: ServerFiles, hosts: Sequence[str]) -> None:
    allowed_hosts = f"\n   HANDOVER_ALLOWED_HOSTS={','.join(hosts)}" if hosts else ""
    print(f"""
Next:
1. Set these for every service, for example in .env, and start the services again:

   HANDOVER_TLS_CERTIFICATE={server.certificate}
   HANDOVER_TLS_KEY={server.key}
   HANDOVER_TLS_AUTHORITY={server.authority}{allowed_hosts}

2. Give {server.authority} to the browsers and programs that connect, as a trusted
   authority. Never give away a file that ends with .key, or key.pem.
3. Open the link of the owner, choose a name and a password, and invite others on the page.
4. Renew the certificates before they expire, with: handover secure renew""")
