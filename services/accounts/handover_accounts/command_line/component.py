"""`handover component`: the programs of others that perform the Tasks of a Device."""

import asyncio
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Final
from urllib.parse import urlsplit

import typer

from handover.broker import BrokerClient, BrokerError, NotFound
from handover.command_line.access import cli_access
from handover.errors import UsageError
from handover.files.durable_files import replace_durably
from handover.network.outbound_policy import address_of, is_loopback
from handover.security.service_access import AccountsUnavailable
from handover.settings import COMPONENTS_FILE
from handover.transport_security.local_authority import AUTHORITY, LocalAuthority, checked_name
from handover.transport_security.server_certificate import ServerCertificate
from handover_accounts.settings import AccountsSettings

_NAME: Final = re.compile(r"^[A-Za-z0-9_.-]{1,64}$")
_PORTS: Final = {"http": 80, "https": 443}
_NO_URL: Final = re.compile(r"""[\s'"\\]""")

app = typer.Typer(help="Programs of your own that perform Tasks.", no_args_is_help=True)

DataDir = Annotated[Path | None, typer.Option("--data-dir", help="The data directory of the cell.")]
Name = Annotated[str, typer.Argument(help="The name of the component, as in `serve(Lamp, NAME, …)`.")]


@app.command()
def add(  # noqa: PLR0917 - the options of the command
    name: Name,
    device: Annotated[
        str, typer.Option("--device", help="The Device whose Tasks it performs: its name or URN.")
    ],
    url: Annotated[
        str | None,
        typer.Option("--url", help="Where it receives notifications, such as http://127.0.0.1:9100."),
    ] = None,
    cell: Annotated[
        str | None,
        typer.Option(
            "--cell",
            help="The name or address by which a component on another machine reaches the cell; by default "
            "the first in the cell's certificate, if --url is on another machine.",
        ),
    ] = None,
    file: Annotated[Path | None, typer.Option("--file", help="The new file; NAME.env if absent.")] = None,
    data_dir: DataDir = None,
) -> None:
    """Make one file with all that a component needs: addresses, certificates, and a token for its Device.

    A second call for the same name revokes the former token.
    """
    from handover_accounts.set_up import issue_component_token  # noqa: PLC0415 - the database is slow

    settings = _settings(data_dir)
    if not _NAME.match(name):
        raise UsageError(f'"{name}" can be no name: 1 to 64 letters, digits, "_", "." or "-"')
    urn = settings.entity_id("Device", device.removeprefix("Device:"))
    target = Path(f"{name}.env") if file is None else file
    if target.exists():
        raise UsageError(f"{target} exists; nothing was made. Remove it, or choose another with --file")
    endpoint = None if url is None else _endpoint_of(url)
    head = [
        f"# {name} performs the Tasks of {urn}; use this file as .env",
        f"# notifications: {url or 'none'}",
    ]
    lines = [*head, *_server_lines(settings, url), *_cell_lines(settings, name, cell, url)]
    token = issue_component_token(settings, name, urn)
    lines.insert(len(head), f"HANDOVER_SERVICE_TOKEN='{token}'")
    replace_durably(target, "".join(f"{line}\n" for line in lines).encode(), mode=0o600)
    _note_endpoint(settings, name, endpoint)
    print(f"{target}: addresses, authority and token of {name} for {urn}")
    print("Copy it as .env to the folder where the component starts; keep it as you keep secrets.")
    if endpoint is None:
        print(
            "Without --url it gets no notifications; it asks the broker every HANDOVER_RECONCILE_S seconds."
        )


@app.command()
def remove(name: Name, data_dir: DataDir = None) -> None:
    """Revoke the token of a component, and delete its subscriptions."""
    from handover_accounts.set_up import revoke_component_tokens  # noqa: PLC0415 - as above

    settings = _settings(data_dir)
    if not revoke_component_tokens(settings, name) and _noted_endpoint(settings, name) is None:
        raise UsageError(f'there is no component "{name}" with a token')
    endpoint = _noted_endpoint(settings, name)
    try:
        count = asyncio.run(_delete_subscriptions(settings, name, endpoint))
    except (BrokerError, AccountsUnavailable) as error:
        raise UsageError(f"the token of {name} is revoked, but its subscriptions stay: {error}") from None
    _note_endpoint(settings, name, None)
    print(f"the token of {name} is revoked, and {count} subscriptions are deleted")


def _settings(data_dir: Path | None) -> AccountsSettings:
    if data_dir is not None:
        os.environ["HANDOVER_DATA_DIR"] = str(data_dir.absolute())
    return AccountsSettings.load()


def _endpoint_of(url: str) -> str:
    """Return `host:port` of a URL. Raises `UsageError`."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port, parts = None, None, urlsplit("")
    if parts.scheme not in _PORTS or not host or _NO_URL.search(url):
        raise UsageError(f'"{url}" is no address; write http://HOST:PORT or https://HOST:PORT')
    number = port or _PORTS[parts.scheme]
    return f"[{host}]:{number}" if ":" in host else f"{host}:{number}"


def _is_remote(cell: str | None, url: str | None) -> bool:
    return cell is not None or (url is not None and not is_loopback(urlsplit(url).hostname or ""))


def _cell_lines(settings: AccountsSettings, name: str, cell: str | None, url: str | None) -> Iterator[str]:
    """Yield the addresses of the cell for the component, and the authority of its certificates.

    Raises `UsageError` if the component could not reach the cell there, or would not trust it.
    """
    is_remote = _is_remote(cell, url)
    host = _host_of_cell(settings, cell) if is_remote else None

    def reached(address: str) -> str:
        return _as_seen_remotely(settings, address, host) if is_remote else address

    default_context = type(settings).model_fields["context_url"].default
    values = {
        "HANDOVER_FACTORY": settings.factory,
        "HANDOVER_BROKER_URL": reached(settings.broker_url),
        "HANDOVER_BROKER_TENANT": settings.broker_tenant or "",
        "HANDOVER_CONTEXT_URL": settings.context_url if settings.context_url != default_context else "",
        "HANDOVER_LEASE_URLS": ",".join(map(reached, settings.lease_urls or (settings.orchestrator,))),
        "HANDOVER_ACCOUNTS_URL": reached(settings.accounts),
        "HANDOVER_DATA_DIR": f".{name}",
        "HANDOVER_SECURITY_DIR": "" if is_remote else str(settings.security_folder.absolute()),
    }
    yield from (f"{key}='{value}'" for key, value in values.items() if value)
    authority = settings.tls_authority or _authority_folder(settings) / AUTHORITY
    if authority.exists():
        # Readers of PEM skip the other lines. OpenSSL takes the first certificate as that of the server.
        yield from ("HANDOVER_TLS_AUTHORITY='.env'", "AUTHORITY='", authority.read_text().strip(), "'")


def _server_lines(settings: AccountsSettings, url: str | None) -> Iterator[str]:
    """Yield what the server of the component needs: its address, and a certificate if that is https.

    Raises `UsageError` for an address without TLS beyond loopback.
    """
    if url is None:
        return
    parts = urlsplit(url)
    host = checked_name(parts.hostname or "")
    yield f"HANDOVER_COMPONENT_URL='{url.rstrip('/')}'"
    if not is_loopback(host):
        if parts.scheme == "http":
            raise UsageError(f"other machines reach {url}, so it needs TLS; write it as https://…")
        listens = host if address_of(host) is not None else "0.0.0.0"  # noqa: S104 - where a name may point
        yield f"HANDOVER_HOST='{listens}'"
    if parts.scheme == "http":
        return
    folder = _authority_folder(settings)
    if not (folder / "authority.key").exists():
        raise UsageError(
            f"{url} needs a certificate, and there is no authority in {folder} that could make it; make one "
            "with: handover secure"
        )
    certificate, key = LocalAuthority(folder).issue_server([host])
    yield from ("HANDOVER_TLS_CERTIFICATE='.env'", "HANDOVER_TLS_KEY='.env'")
    yield from ("CERTIFICATE='", certificate.decode().strip(), "'", "KEY='", key.decode().strip(), "'")


def _authority_folder(settings: AccountsSettings) -> Path:
    return settings.authority_dir or settings.data_dir / "tls"


def _host_of_cell(settings: AccountsSettings, cell: str | None) -> str | None:
    """Return the host by which other machines reach the cell; None if only its URLs say it."""
    certificate = ServerCertificate.of(settings)
    if cell is None:
        names = () if certificate is None else certificate.names
        listens = () if re.fullmatch(r"[0:.]*", settings.host) else (settings.host,)  # 0.0.0.0 and ::
        usable = (name for name in (*names, *listens) if not is_loopback(name) and "*" not in name)
        return next(usable, None)
    host = checked_name(cell)
    if certificate is not None and not certificate.is_for(host):
        raise UsageError(
            f"the certificate {certificate.path} is for {', '.join(certificate.names)}, not for {host}, so "
            f"the component would not trust the cell; make one with this name: handover secure --name {host}"
        )
    return host


def _as_seen_remotely(settings: AccountsSettings, url: str, host: str | None) -> str:
    """Return an address of the cell for another machine: with `host` if it is of this machine only.

    Raises `UsageError` if other machines do not reach it.
    """
    parts = urlsplit(url)
    if not is_loopback(parts.hostname or ""):
        return url
    if is_loopback(settings.host):
        raise UsageError(
            f"HANDOVER_HOST is {settings.host}, so other machines do not reach {url}; set it to 0.0.0.0 or "
            "an address of this machine, and start the services again"
        )
    if host is None:
        raise UsageError(f"other machines do not reach {url}; name this machine as they do: --cell HOST")
    return f"{parts.scheme}://{f'[{host}]' if ':' in host else host}:{parts.port or _PORTS[parts.scheme]}"


async def _delete_subscriptions(settings: AccountsSettings, name: str, endpoint: str | None) -> int:
    """Delete what a component has subscribed to, by its endpoint or its name; return the number."""
    own = settings.entity_id("Subscription", f"{name}-tasks")
    count = 0
    async with cli_access(settings) as access, BrokerClient(settings, credentials=access) as broker:
        for subscription in await broker.subscriptions():
            uri = str(subscription.get("notification", {}).get("endpoint", {}).get("uri", ""))
            if subscription.get("id") == own or (endpoint is not None and _is_at(uri, endpoint)):
                with suppress(NotFound):
                    await broker.delete_subscription(str(subscription["id"]))
                count += 1
    return count


def _is_at(uri: str, endpoint: str) -> bool:
    try:
        return _endpoint_of(uri) == endpoint
    except UsageError:
        return False


def _noted_endpoint(settings: AccountsSettings, name: str) -> str | None:
    file = settings.security_folder / COMPONENTS_FILE
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return next((line.partition(" ")[0] for line in lines if line.partition(" ")[2] == name), None)


def _note_endpoint(settings: AccountsSettings, name: str, endpoint: str | None) -> None:
    """Allow the broker to notify a component at its endpoint alone."""
    file = settings.security_folder / COMPONENTS_FILE
    lines_before = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    others = [line for line in lines_before if line.partition(" ")[2] != name]
    lines = others if endpoint is None else [*others, f"{endpoint} {name}"]
    if lines != lines_before:
        replace_durably(file, "".join(f"{line}\n" for line in lines).encode(), mode=0o644)
