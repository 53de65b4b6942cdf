"""A check of the keys and tokens of an installation, which `handover check` prints. It writes nothing."""

from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

from sqlalchemy import Connection, create_engine, func, select
from sqlalchemy.exc import DBAPIError

from handover.errors import UsageError
from handover.security.access_tokens import read_public_keys
from handover.security.accounts_mark import missing_keys, sign_of_accounts
from handover.security.caller import CallerKind
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.service_access import read_service_token, service_token_file
from handover.settings import SERVICE_TOKENS_FOLDER
from handover.subscriptions.notifications import is_notification_key
from handover_accounts.lost_database import require_anybody, require_file
from handover_accounts.settings import AccountsSettings
from handover_accounts.signing_keys import SigningKeys
from handover_accounts.storage import secret_token_store, tables

T = TypeVar("T")

REMEDY: Final = "run `handover accounts set-up`, which writes it again"


def faults_in(settings: AccountsSettings) -> Iterator[str]:
    """Yield each fault of the keys of accounts, the tokens of services and the keys of notifications."""
    for file in sorted(settings.data_dir.glob("*.notification-key")):
        try:
            key = file.read_bytes().decode("ascii", "replace").strip()
        except OSError as error:
            yield f"{file} cannot be read: {error.strerror}; delete it, and the service makes a new one"
            continue
        if not is_notification_key(key):
            yield f"{file} is damaged: it holds no key; delete it, and the service makes a new one"
    public = settings.security_folder / PUBLIC_KEYS_FILE
    try:
        if not public.exists():
            if (sign := sign_of_accounts(settings)) is not None:
                yield str(missing_keys(public, sign))
            return
        require_file(settings)
        _rows(settings, partial(require_anybody, settings))
    except UsageError as error:
        yield str(error)
        return
    yield from _faults_of_keys(settings, public)
    yield from _faults_of_tokens(settings)


def _faults_of_keys(settings: AccountsSettings, public: Path) -> Iterator[str]:
    try:
        read_public_keys(public)
    except UsageError as error:
        yield str(error)
        if not public.is_file():
            return
    private = settings.signing_keys_file
    if not private.exists():
        if _rows(settings, _count_people):
            yield str(missing_keys(private, f"{settings.data_dir / 'accounts.db'}, which has people,"))
        return
    try:
        if not SigningKeys(private, settings.security_folder).are_published():
            yield f"{public} does not have the keys of {private}; {REMEDY}"
    except UsageError as error:
        yield str(error)


def _faults_of_tokens(settings: AccountsSettings) -> Iterator[str]:
    for file in sorted((settings.security_folder / SERVICE_TOKENS_FOLDER).glob("*")):
        try:
            token = read_service_token(file)
        except (OSError, UsageError) as error:
            yield str(error)
            continue
        if not (settings.data_dir / "accounts.db").exists():
            continue
        row = _rows(settings, partial(secret_token_store.find_token, token=token))
        if row is None or row["kind"] != CallerKind.SERVICE or row["name"] != file.name:
            yield f"{file} is damaged: accounts does not know its token; {REMEDY}"
    if not (settings.service_token or settings.service_token_file or settings.secrets_dir):
        yield from _missing_tokens(settings)


def _missing_tokens(settings: AccountsSettings) -> Iterator[str]:
    """Yield the missing files of services that have a token, and run with this data directory."""
    for name in sorted(_rows(settings, _services) or ()):
        file = service_token_file(settings, name)
        if not file.exists() and (settings.data_dir / f"{name}.accounts").exists():
            yield f"{file} is missing; {REMEDY}"


def _services(connection: Connection) -> list[str]:
    table = tables.tokens
    return list(connection.execute(select(table.c.name).where(table.c.kind == CallerKind.SERVICE)).scalars())


def _count_people(connection: Connection) -> int:
    return int(connection.execute(select(func.count()).select_from(tables.users)).scalar() or 0)


def _rows(settings: AccountsSettings, read: Callable[[Connection], T]) -> T | None:
    """Return what `read` returns for the file of accounts; None without one that can be read."""
    file = settings.data_dir / "accounts.db"
    if not file.exists():
        return None
    engine = create_engine(f"sqlite:///file:{file.absolute()}?mode=ro&uri=true")
    try:
        with closing(engine.connect()) as connection:
            return read(connection)
    except DBAPIError:  # reported with the databases
        return None
    finally:
        engine.dispose()
