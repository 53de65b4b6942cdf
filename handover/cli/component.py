"""`handover component`: the programs of others that perform the Tasks of a Device."""

import asyncio
import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Final
from urllib.parse import urlsplit

import typer

from handover.broker import BrokerClient, BrokerError, NotFound
from handover.cli.access import cli_access
from handover.durable_files import replace_durably
from handover.errors import UsageError
from handover.security.service_access import AccountsUnavailable
from handover.settings import COMPONENTS_FILE
from handover.transport_security.local_authority import AUTHORITY
from services.accounts.settings import AccountsSettings

_NAME: Final = re.compile(r"^[A-Za-z0-9_.-]{1,64}$")

app = typer.Typer(help="Programs of your own that perform Tasks.", no_args_is_help=True)

DataDir = Annotated[Path | None, typer.Option("--data-dir", help="The data directory of the cell.")]
Name = Annotated[str, typer.Argument(help="The name of the component, as in `serve(Lamp, NAME, …)`.")]


@app.command()
def add(
    name: Name,
    device: Annotated[
        str, typer.Option("--device", help="The Device whose Tasks it performs: its name or URN.")
    ],
    url: Annotated[
        str | None,
        typer.Option("--url", help="Where it receives notifications, such as http://127.0.0.1:9100."),
    ] = None,
    file: Annotated[Path | None, typer.Option("--file", help="The new file; NAME.env if absent.")] = None,
    data_dir: DataDir = None,
) -> None:
    """Make one file with all that a component needs: addresses, authority, and a token for its Device alone.

    A second call for the same name revokes the former token.
    """
    from services.accounts.set_up import issue_component_token  # noqa: PLC0415 - the database is slow

    settings = _settings(data_dir)
    if not _NAME.match(name):
        raise UsageError(f'"{name}" can be no name: 1 to 64 letters, digits, "_", "." or "-"')
    urn = settings.entity_id("Device", device.removeprefix("Device:"))
    target = Path(f"{name}.env") if file is None else file
    if target.exists():
        raise UsageError(f"{target} exists; nothing was made. Remove it, or choose another with --file")
    endpoint = None if url is None else _endpoint_of(url)
    token = issue_component_token(settings, name, urn)
    lines = _lines(settings, name, urn, token, url)
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
    from services.accounts.set_up import revoke_component_tokens  # noqa: PLC0415 - as above

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
    if parts.scheme not in {"http", "https"} or not host:
        raise UsageError(f'"{url}" is no address; write http://HOST:PORT or https://HOST:PORT')
    number = port or (443 if parts.scheme == "https" else 80)
    return f"[{host}]:{number}" if ":" in host else f"{host}:{number}"


def _lines(settings: AccountsSettings, name: str, urn: str, token: str, url: str | None) -> list[str]:
    values = {
        "HANDOVER_FACTORY": settings.factory,
        "HANDOVER_BROKER_URL": settings.broker_url,
        "HANDOVER_BROKER_TENANT": settings.broker_tenant or "",
        "HANDOVER_LEASE_URLS": ",".join(settings.lease_urls) or settings.orchestrator,
        "HANDOVER_ACCOUNTS_URL": settings.accounts,
        "HANDOVER_SERVICE_TOKEN": token,
        "HANDOVER_DATA_DIR": f".{name}",
        "HANDOVER_SECURITY_DIR": str(settings.security_folder.absolute()),
    }
    lines = [f"# {name} performs the Tasks of {urn}; use this file as .env"]
    lines += [f"# notifications: {url or 'none'}"]
    lines += [f"{key}='{value}'" for key, value in values.items() if value]
    folder = settings.authority_dir or settings.data_dir / "tls"
    authority = settings.tls_authority or folder / AUTHORITY
    if authority.exists():
        # The certificate stands in this file, too: readers of PEM skip the other lines.
        lines += ["HANDOVER_TLS_AUTHORITY='.env'", "AUTHORITY='", authority.read_text().strip(), "'"]
    return lines


async def _delete_subscriptions(settings: AccountsSettings, name: str, endpoint: str | None) -> int:
    """Delete what a component has subscribed to, by its endpoint or its name; return the number."""
    own = settings.entity_id("Subscription", f"{name}-tasks")
    count = 0
    async with cli_access(settings) as access, BrokerClient(settings, credentials=access) as broker:
        for one in await broker.subscriptions():
            uri = str(one.get("notification", {}).get("endpoint", {}).get("uri", ""))
            if one.get("id") == own or (endpoint is not None and _is_at(uri, endpoint)):
                with suppress(NotFound):
                    await broker.delete_subscription(str(one["id"]))
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
    known = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    others = [line for line in known if line.partition(" ")[2] != name]
    lines = others if endpoint is None else [*others, f"{endpoint} {name}"]
    if lines != known:
        replace_durably(file, "".join(f"{line}\n" for line in lines).encode(), mode=0o644)
