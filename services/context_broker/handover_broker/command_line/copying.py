"""`handover broker copy`: the brokers and tenants that are meant, the credentials, and what is printed."""

import asyncio
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

import orjson

from handover.broker import BrokerUnavailable
from handover.broker_copy.broker_side import BrokerPlace
from handover.broker_copy.copying import (
    HISTORY_STAYS,
    CopyReport,
    copy_broker,
    explained,
    place_at,
    tenants_of,
)
from handover.broker_copy.report import Counts, Say
from handover.command_line.access import cli_access
from handover.errors import UsageError
from handover.security.service_access import ServiceAccess
from handover.settings import Settings

_NO_CREDENTIALS: Final[dict[str, Path | None]] = {
    "broker_token_file": None,
    "broker_headers": None,
    "broker_oauth_url": None,
    "broker_oauth_client": None,
    "broker_oauth_secret": None,
}


@dataclass(frozen=True, slots=True)
class CopyWish:
    """What a person asks to be copied."""

    source: str
    target: str
    tenants: tuple[str, ...] = ()
    only: bool = False
    overwrites: bool = False
    source_token_file: Path | None = None
    target_token_file: Path | None = None


def run_copy(wish: CopyWish, *, as_json: bool) -> bool:
    """Copy and print; return whether the target has everything, and the same. Raises `UsageError`."""
    if wish.only and not wish.tenants:
        raise UsageError("--only copies the tenants of --tenant; name at least one")

    def say(line: str) -> None:
        print(line, file=sys.stderr if as_json else sys.stdout, flush=True)

    report = asyncio.run(_copy(wish, say))
    if as_json:
        print(orjson.dumps(report.as_json(), option=orjson.OPT_INDENT_2).decode())
    else:
        _print_summary(report)
    return report.is_equal


async def _copy(wish: CopyWish, say: Say) -> CopyReport:
    settings = Settings.load()
    source = _settings_for(wish.source, settings, wish.source_token_file)
    target = _settings_for(wish.target, settings, wish.target_token_file)
    async with cli_access(settings) as access:
        try:
            first = await _place(source, settings, access)
            second = await _place(target, settings, access)
            listed = await tenants_of(first)
        except BrokerUnavailable as error:
            why = explained(error, "Nothing was copied")
            return CopyReport(source.broker_url, target.broker_url, error=why)
        if listed is None and not wish.only:
            say(f"{first.url} does not list its tenants: name each one with --tenant")
        tenants = _tenants(wish, settings, first, listed)
        return await copy_broker(first, second, tenants, say, overwrites=wish.overwrites)


async def _place(there: Settings, settings: Settings, access: ServiceAccess) -> BrokerPlace:
    """Return a broker; that of this cell gets our own credentials, if it is ours."""
    return await place_at(there, access if there.broker_url == settings.broker_url else None)


def _tenants(
    wish: CopyWish, settings: Settings, source: BrokerPlace, listed: Sequence[str] | None
) -> list[str]:
    """Return the tenants to copy: the default one, that of the cell, those listed and those named."""
    if wish.only:
        return list(dict.fromkeys(wish.tenants))
    own = settings.broker_tenant if source.url == settings.broker_url else None
    return list(dict.fromkeys(["", *([own] if own else []), *(listed or ()), *wish.tenants]))


def _settings_for(address: str, settings: Settings, token_file: Path | None) -> Settings:
    """Return the settings for a broker: those of the cell have credentials for its own broker only."""
    url = address.rstrip("/").removesuffix("/ngsi-ld/v1")
    parts = urlsplit(url)
    if parts.scheme not in {"http", "https"} or not parts.hostname:
        raise UsageError(f'"{address}" is no URL of a broker; write it as http://127.0.0.1:1026')
    if parts.username is not None:
        raise UsageError("the URL of a broker has no user and password; use a file with a token")
    changes: dict[str, Path | None] = {}
    if token_file is not None:
        if not token_file.is_file():
            raise UsageError(f"there is no token file {token_file}; write the token for {url} into it")
        changes = {**_NO_CREDENTIALS, "broker_token_file": token_file}
    elif url != settings.broker_url:
        changes = dict(_NO_CREDENTIALS)
    return settings.model_copy(update={**changes, "broker_url": url})


def _print_summary(report: CopyReport) -> None:
    for entry in report.tenants:
        print(f"{entry.title}: {_counted('entities', entry.entities)}")
        for name, counts in entry.documents.items():
            if counts.found:
                print(f"  {_counted(name.replace('_', ' '), counts)}")
        if entry.problem_count:
            print(f"  {entry.problem_count} problems")
    print(f"tenants: {', '.join(entry.title for entry in report.tenants) or 'none'}")
    print(HISTORY_STAYS)
    if report.is_equal:
        print(f"{report.target} has everything of {report.source}, and the same")
        return
    if any(problem.get("attribute") for entry in report.tenants for problem in entry.problems):
        print("what differs was not replaced; --overwrite replaces it, unless TO itself changes it")
    print(f"{report.target} is not equal to {report.source}: {report.error or 'see above'}", file=sys.stderr)


def _counted(name: str, counts: Counts) -> str:
    parts = {
        "created": counts.created,
        "replaced": counts.replaced,
        "present before": counts.present,
        "skipped": counts.skipped,
    }
    done = ", ".join(f"{number} {words}" for words, number in parts.items() if number)
    return f"{counts.found} {name}, {counts.equal} equal" + (f" ({done})" if done else "")
