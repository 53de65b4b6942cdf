"""Setting up accounts on the machine itself: keys, tokens of the services, the link of the owner.

The commands call this, beside a running service or without one. The keys come last: they end local mode, and
every service has its token by then.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sqlalchemy import func, select

from handover.errors import Problem, UsageError
from handover.files.durable_files import replace_durably
from handover.security.caller import CallerKind
from handover.security.glove_token import GLOVE_TOKEN_SECRET, make_glove_token, remove_glove_token
from handover.security.permissions import Grant, Role
from handover.security.resource_patterns import require_pattern
from handover.security.service_access import service_token_file
from handover_accounts.lost_database import require_anybody, require_file
from handover_accounts.settings import AccountsSettings
from handover_accounts.signing_keys import SigningKeys
from handover_accounts.storage import links, secret_token_store, tables
from handover_accounts.storage.changes import Change, Store

COMMAND: Final = "command-line"
"""The subject of what a command does: a person with access to the files of accounts."""


@dataclass(frozen=True, slots=True)
class SetUp:
    """What was made: the names of the services with a new token, and the secret of the owner's link.

    There is no link if a user exists already.
    """

    is_new: bool
    services: tuple[str, ...]
    owner_link: str | None


@contextmanager
def opened_store(settings: AccountsSettings) -> Iterator[Store]:
    """Yield the database of accounts. Raises `UsageError` if it was lost."""
    require_file(settings)
    store = Store(settings.database("accounts"))
    try:
        store.prepare()
        with store.read() as connection:
            require_anybody(settings, connection)
        yield store
    finally:
        store.close()


def set_up(
    settings: AccountsSettings, services: Iterable[str], *, token_files: Mapping[str, Path] | None = None
) -> SetUp:
    """Make what is missing; changes nothing that exists. Raises `UsageError`.

    `token_files` are the files of the tokens of services that read them elsewhere than in the security
    directory.
    """
    files = {name: service_token_file(settings, name) for name in services} | dict(token_files or {})
    keys = SigningKeys(settings.signing_keys_file, settings.security_folder)
    with opened_store(settings) as store:
        made = tuple(name for name, file in files.items() if _make_service_token(store, file, name))
        if settings.secrets_dir is not None and (settings.secrets_dir / GLOVE_TOKEN_SECRET).exists():
            remove_glove_token(settings.security_folder)
        else:
            make_glove_token(settings.security_folder)
        is_new = keys.create()
        with store.read() as connection:
            has_users = bool(connection.execute(select(func.count()).select_from(tables.users)).scalar_one())
        return SetUp(is_new, made, None if has_users else _owner_link(store))


def owner_link(settings: AccountsSettings) -> str:
    """Make a link for an owner, also for an installation whose admins lost their passwords."""
    if not SigningKeys(settings.signing_keys_file, settings.security_folder).exist():
        raise UsageError("there are no accounts yet; run `handover accounts set-up` first")
    with opened_store(settings) as store:
        return _owner_link(store)


def _owner_link(store: Store) -> str:
    try:
        with store.change(COMMAND) as change:
            return links.make_owner_link(change)
    except Problem as problem:
        raise UsageError(problem.detail) from None


def _make_service_token(store: Store, file: Path, service: str) -> bool:
    """Make the token of a service unless its file has a valid one; return whether it was made."""
    try:
        if file.exists():
            with store.read() as connection:
                row = secret_token_store.find_token(connection, file.read_text(encoding="utf-8").strip())
            if row is not None and row["kind"] == CallerKind.SERVICE and row["name"] == service:
                return False
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with store.change(COMMAND) as change:
            token = secret_token_store.replace_service_token(change, service)
            replace_durably(file, f"{token}\n".encode(), mode=0o600)
    except OSError as error:
        raise UsageError(f"the token of {service} cannot be written to {file}: {error.strerror}") from None
    return True


def issue_component_token(settings: AccountsSettings, name: str, device: str) -> str:
    """Return a new token for the component `name`, with the rights of a performer of `device` and no others.

    Its former tokens are revoked; the new one has their subject, so that its subscriptions remain its own.
    Raises `UsageError` without accounts.
    """
    if not SigningKeys(settings.signing_keys_file, settings.security_folder).exist():
        raise UsageError(
            "there are no accounts yet, so a component on this machine needs no token; to have accounts: "
            "handover secure"
        )
    try:
        with opened_store(settings) as store, store.change(COMMAND) as change:
            former = next(iter(_revoke_component_tokens(change, name)), None)
            grants = (Grant(Role.PERFORMER, require_pattern(device)),)
            _, token = secret_token_store.issue(
                change, CallerKind.SCRIPT, _token_name(name), grants, None, subject=former
            )
            return token
    except Problem as problem:
        raise UsageError(problem.detail) from None


def revoke_component_tokens(settings: AccountsSettings, name: str) -> int:
    """Revoke the tokens of the component `name`; return how many there were."""
    with opened_store(settings) as store, store.change(COMMAND) as change:
        return len(_revoke_component_tokens(change, name))


def _revoke_component_tokens(change: Change, name: str) -> list[str]:
    """Revoke the tokens of a component; return their subjects."""
    query = select(tables.tokens.c.subject).where(
        tables.tokens.c.kind == CallerKind.SCRIPT, tables.tokens.c.name == _token_name(name)
    )
    subjects = list(change.connection.execute(query).scalars())
    for subject in subjects:
        secret_token_store.revoke_token(change, subject)
    return subjects


def _token_name(component: str) -> str:
    return f"component {component}"
