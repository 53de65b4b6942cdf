"""The directory of accounts: changes and reads off the event loop, sign-in, tokens, and the revocations."""

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, Self, TypeVar

from sqlalchemy import Column, Connection, func, select

from handover.database.outage import in_database
from handover.errors import Problem, UsageError
from handover.network.client_networks import network_of
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.access_tokens import SERVICE_TOKEN_S, USER_TOKEN_S
from handover.security.accounts_mark import missing_keys
from handover.security.caller import Caller, CallerKind
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.permissions import Grant, Permission, Role
from handover.security.revocations import FollowedRevocations
from handover_accounts.lost_database import require_anybody, require_file
from handover_accounts.metrics import SIGN_INS
from handover_accounts.passwords import (
    PasswordHashes,
    normalized,
    require_good_password,
    too_many_attempts,
)
from handover_accounts.settings import AccountsSettings
from handover_accounts.sign_in_limits import SignInLimits
from handover_accounts.signing_keys import SigningKeys
from handover_accounts.storage import links, secret_token_store, sessions, stations, tables, users
from handover_accounts.storage.changes import Change, Store, revision_of
from handover_accounts.storage.grants import grants_of
from handover_accounts.storage.identifiers import IdentifierHashes, IdentifierKind, identified
from handover_accounts.storage.sessions import SessionLimits

T = TypeVar("T")

LOOK_EVERY_S: Final = 0.5
"""Another process (a command, a replica) may revoke too."""
NOTE_EVERY_S: Final = 5.0
"""The times of the last use are written together: a request that only reads does not wait for the disk."""
CLEAN_EVERY_S: Final = 600.0
LEAVE_EVERY_S: Final = 2.0
"""People leave stations by time at most so much later."""
NOBODY: Final = "unknown"
"""The actor of a failed sign-in."""


class OwnRevocations(FollowedRevocations):
    """The revocations of accounts itself, which knows its own at once, also while it is flooded."""

    def is_current(self) -> bool:
        """Return True."""
        return True


class Directory:
    """All accounts; an asynchronous context manager."""

    def __init__(self, settings: AccountsSettings) -> None:
        require_file(settings)  # the store makes it
        self.settings = settings
        self.store = Store(settings.database("accounts"))
        self.keys = SigningKeys(settings.signing_keys_file, settings.security_folder)
        self.revocations = OwnRevocations()
        self.session_limits = SessionLimits(settings.session_idle_h * 3600, settings.session_max_h * 3600)
        self.identifiers = IdentifierHashes(settings.identifier_key_file)
        self._hashes = PasswordHashes(settings.password_workers)
        self._limits = SignInLimits()
        self._revoked = asyncio.Event()
        self._uses: dict[Column[Any], dict[str, float]] = {}
        self._tasks = BackgroundTasks("accounts")

    async def __aenter__(self) -> Self:
        await asyncio.to_thread(self.store.prepare)
        await asyncio.to_thread(self._require_keys)
        await self._look()
        await self._tasks.__aenter__()
        self._tasks.start_restarting(self._follow)
        self._tasks.start_restarting(self._note)
        self._tasks.start_restarting(self._clean)
        self._tasks.start_restarting(self._leave_by_time)
        return self

    def _require_keys(self) -> None:
        """Raise `UsageError` if there are people, but a file of the keys is missing, or the reverse."""
        with self.store.read() as connection:
            require_anybody(self.settings, connection)
            if not connection.execute(select(func.count()).select_from(tables.users)).scalar():
                return
        for file in (self.settings.security_folder / PUBLIC_KEYS_FILE, self.settings.signing_keys_file):
            if not file.exists():
                raise missing_keys(file, "the database of accounts, which has people,")
        if not self.keys.are_published():
            raise UsageError(
                f"{self.settings.security_folder / PUBLIC_KEYS_FILE} does not have the keys of "
                f"{self.settings.signing_keys_file}; run `handover accounts set-up`, which writes it again"
            )

    async def __aexit__(self, *_: object) -> None:
        await self._tasks.__aexit__(None, None, None)
        await self._note_uses()
        self._hashes.close()
        self.store.close()

    async def change(self, actor: str, function: Callable[[Change], T], *, method: str = "") -> T:
        """Run `function` in one transaction; its revocations are in force when this returns."""

        def run() -> T:
            with self.store.change(actor, method) as change:
                return function(change)

        result = await in_database(run)
        with suppress(Problem):  # it has been changed: a database that goes away now must not say otherwise
            await self._look()  # otherwise `_follow` does it as soon as there is a database
        return result

    async def read(self, function: Callable[[Connection], T]) -> T:
        """Return the result of `function` on a connection."""

        def run() -> T:
            with self.store.read() as connection:
                return function(connection)

        return await in_database(run)

    # Revocations

    async def revocations_after(self, position: int, wait_s: float) -> dict[str, Any]:
        """Return the revocations after `position`; wait up to `wait_s` for the first."""
        deadline_s = time.monotonic() + wait_s
        while position == self.revocations.position and time.monotonic() < deadline_s:
            try:
                async with asyncio.timeout(deadline_s - time.monotonic()):
                    await self._revoked.wait()
            except TimeoutError:
                break
        return await self.read(lambda connection: _revoked_after(connection, position))

    async def _look(self) -> None:
        position = self.revocations.position
        document = await self.read(lambda connection: _revoked_after(connection, position))
        self.revocations.apply(document)
        if document["position"] != position:
            self._revoked.set()
            self._revoked = asyncio.Event()

    async def _follow(self) -> None:
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            await self._look()

    async def _note(self) -> None:
        while True:
            await asyncio.sleep(NOTE_EVERY_S)
            await self._note_uses()

    async def _note_uses(self) -> None:
        uses, self._uses = self._uses, {}
        if uses:
            await in_database(self.store.note_uses, uses)

    async def _clean(self) -> None:
        while True:
            await asyncio.to_thread(self._delete_old)
            await asyncio.sleep(CLEAN_EVERY_S)

    async def _leave_by_time(self) -> None:
        while True:
            await asyncio.sleep(LEAVE_EVERY_S)
            if await self.read(stations.has_due):
                await self.change("accounts", stations.leave_by_time, method="time")

    def _delete_old(self) -> None:
        if self.keys.exist():
            self.keys.expire()
        with self.store.change("accounts", "retention") as change:
            sessions.delete_ended(change, self.session_limits)
            days = self.settings.audit_retention_days
            if days:
                before_ms = int((time.time() - days * 86400) * 1000)
                if gone := self.store.audit.expire(change.connection, before_ms):
                    change.record("audit.expired", text=f"{gone} records older than {days:g} days")
            change.is_recorded = True  # nothing may have been old

    # Sign-in

    def require_accounts(self) -> None:
        """Raise `Problem` 409 in local mode."""
        if not self.keys.exist():
            raise Problem(
                409,
                "Local mode",
                "there are no accounts yet: everybody on this machine is the owner; run `handover accounts "
                "set-up`",
            )

    async def sign_in(self, name: str, password: str, address: str, device: str) -> dict[str, Any]:
        """Open a session. Raises `Problem`: 401 for a wrong name or password, 429 for too many attempts."""
        self.require_accounts()
        key = users.name_key(name)
        self.admit_attempt(address, key)

        def found(connection: Connection) -> tuple[dict[str, Any] | None, bool]:
            user = users.find_by_name(connection, name)
            is_known = user is not None and sessions.is_known_place(connection, user["subject"], address)
            return user, is_known

        user, is_known = await self.read(found)
        stored = None if user is None else user["password_hash"]
        if not await self._hashes.verify(normalized(password), stored, is_known=is_known) or user is None:
            SIGN_INS.labels("refused").inc()
            about = "" if user is None else user["subject"]
            text = f"{name[:64]} from {address[:64]}, {device[:300]}"
            await self.change(
                NOBODY, lambda change: change.record("signIn.failed", about, text=text, outcome="refused")
            )
            raise Problem(401, "Wrong name or password", "the name or the password is wrong; correct it")
        self.sign_in_succeeded(address, key)
        SIGN_INS.labels("accepted").inc()
        return await self._open(user["subject"], "password", address, device)

    def admit_attempt(self, address: str, account: str) -> None:
        """Count an attempt to guess a secret; raise `Problem` 429 if it comes too early."""
        wait_s = self._limits.attempt(address, account, time.monotonic())
        if wait_s is not None:
            SIGN_INS.labels("limited").inc()
            raise too_many_attempts(wait_s)

    def sign_in_succeeded(self, address: str, account: str) -> None:
        """Forget the failures of an address for an account."""
        self._limits.succeeded(address, account)

    async def _open(self, subject: str, method: str, address: str, device: str) -> dict[str, Any]:
        def opened(change: Change) -> tuple[str, str]:
            users.find(change.connection, subject)  # deleted while the password was checked
            return sessions.open_session(change, subject, method=method, address=address, device=device)

        _, token = await self.change(subject, opened, method=method)
        return {"session": token, "maxAgeS": int(self.session_limits.max_s)}

    async def use_link(
        self, secret: str, name: str | None, password: str, address: str, device: str
    ) -> dict[str, Any]:
        """Use a one-time link and open a session. Raises `Problem` 404, 409, 422, 429."""
        self.require_accounts()
        self.admit_attempt(address, "link")
        link = await self.read(lambda connection: links.find_link(connection, secret))
        if link["subject"] is not None:
            owner = await self.read(lambda connection: users.find(connection, link["subject"]))
            wanted = str(owner["name"])
        else:
            wanted = users.checked_name(name or link["name"] or "")
        hashed = await self._hashes.hash(require_good_password(password, wanted))
        subject = await self.change(
            link["subject"] or link["id"],
            lambda change: links.use_link(change, secret, wanted, hashed),
            method="link",
        )
        self._limits.succeeded(address, "link")
        return await self._open(subject, "link", address, device)

    async def change_password(self, session_token: str, current: str, new: str, address: str) -> None:
        """Change the password of the user of a session, and end the other sessions.

        `address` is that of the person, for the limit of attempts. Raises `Problem`: 401 if the session has
        ended, 403 for a wrong password, 422 for a weak one, 429.
        """

        def found(connection: Connection) -> tuple[dict[str, Any], dict[str, Any]]:
            session = sessions.require_session(connection, session_token, self.session_limits)
            return session, users.find(connection, session["subject"])

        session, user = await self.read(found)
        subject = user["subject"]
        self.admit_attempt(address, subject)
        if not await self._hashes.verify(normalized(current), user["password_hash"], is_known=True):
            text = f"from {address[:64]}"
            await self.change(
                subject,
                lambda change: change.record("passwordChange.failed", subject, text=text, outcome="refused"),
                method="password",
            )
            raise Problem(403, "Wrong password", "the current password is wrong; correct it")
        self._limits.succeeded(address, subject)
        hashed = await self._hashes.hash(require_good_password(new, user["name"]))
        await self.change(
            subject,
            lambda change: users.set_password(change, subject, hashed, kept_session=session["id"]),
            method="password",
        )

    async def end_session(self, token: str) -> None:
        """Sign out; has no effect for a session that has ended."""

        def end(change: Change) -> None:
            row = sessions.find_session(change.connection, token, self.session_limits)
            change.is_recorded = True
            if row is not None:
                change.actor = row["subject"]
                sessions.end_session(change, row["id"])

        await self.change(NOBODY, end)

    # Stations

    async def join(self, station: str, kind: IdentifierKind, value: str) -> None:
        """Let the person join a station who has an identifier. Raises `Problem` 404, 409, 429."""
        self.admit_attempt(station, "join")

        def recognized(change: Change) -> None:
            stations.require_station(change.connection, station)
            change.actor = identified(change.connection, self.identifiers, kind, value)
            stations.join(change, station, change.actor, kind)

        await self.change(NOBODY, recognized, method=kind)
        self._limits.succeeded(station, "join")

    async def admit_sign_out(self, token: str, pin: str | None) -> None:
        """Admit the end of a session: that of a station needs the PIN of who has joined, or of an engineer.

        Otherwise anybody who passes could end the work at the station, which an engineer has to sign in
        again. Raises `Problem` 403, 429.
        """

        def station_of_session(connection: Connection) -> str | None:
            session = sessions.find_session(connection, token, self.session_limits)
            if session is None or stations.station_of(connection, session["subject"]) is None:
                return None
            return str(session["subject"])

        station = await self.read(station_of_session)
        if station is None:
            return
        if pin:
            self.admit_attempt(station, "sign-out")
        owner = await self.read(lambda connection: self._may_sign_out(connection, station, pin or ""))
        if owner is None:
            await self.change(
                station,
                lambda change: change.record("station.signedOut", station, outcome="refused"),
                method=IdentifierKind.PIN,
            )
            raise Problem.translated(
                403,
                "PIN needed",
                "station.pinNeeded",
                "a station is signed out with the PIN of the person who has joined it, or of an engineer;"
                " an engineer without a PIN removes the station on the page People",
            )
        self._limits.succeeded(station, "sign-out")
        await self.change(
            owner, lambda change: change.record("station.signedOut", station), method=IdentifierKind.PIN
        )

    def _may_sign_out(self, connection: Connection, station: str, pin: str) -> str | None:
        """Return the subject whose PIN it is, if that person may sign the station out."""
        try:
            owner = identified(connection, self.identifiers, IdentifierKind.PIN, pin)
        except Problem:
            return None
        present = stations.joined(connection, station)
        is_joined = present is not None and present["subject"] == owner
        may_configure = any(grant.allows(Permission.CONFIGURE, "*") for grant in grants_of(connection, owner))
        return owner if is_joined or may_configure else None

    async def is_pin_of(self, person: str, pin: str) -> bool:
        """Return whether a PIN is that of a Person. Raises `Problem` 429."""
        self.admit_attempt(person, "pin")

        def found(connection: Connection) -> str | None:
            owner = identified(connection, self.identifiers, IdentifierKind.PIN, pin)
            return str(users.find(connection, owner)["person"])

        try:
            is_right = await self.read(found) == person
        except Problem:
            is_right = False
        if is_right:
            self._limits.succeeded(person, "pin")
        return is_right

    # Access tokens

    async def user_token(self, session_token: str) -> dict[str, Any]:
        """Return the access token of a session, its user and its CSRF token. Raises `Problem` 401."""
        self.require_accounts()

        def found(connection: Connection) -> tuple[Caller, dict[str, Any], bool]:
            session = sessions.find_session_with_user(connection, session_token, self.session_limits)
            if session is None:
                raise Problem(401, "Signed out", "the session has ended; sign in again")
            subject, is_station = session["subject"], session["station"] is not None
            acting = (stations.joined(connection, subject) if is_station else None) or session
            caller = Caller(
                CallerKind.USER,
                subject,
                acting["name"],
                grants_of(connection, subject),
                person=acting["person"],
                session=session["id"],
                revision=session["revision"],
            )
            return caller, session, is_station

        caller, session, is_station = await self.read(found)
        self._uses.setdefault(tables.sessions.c.seen_s, {})[session["id"]] = time.time()
        return {
            "token": self.keys.signing_key().issue(caller, valid_s=USER_TOKEN_S),
            "expiresInS": USER_TOKEN_S,
            "csrf": sessions.csrf_token(session_token),
            "isStation": is_station,
            "endsInS": max(self.session_limits.ends_s(session) - time.time(), 0.0),
            "network": network_of(session["address"]) if self.settings.session_bound else None,
        }

    async def service_token(self, caller: Caller) -> dict[str, Any]:
        """Return the access token of a service that was authenticated by its secret token."""
        revision = await self.read(revision_of)
        issued = Caller(
            CallerKind.SERVICE, caller.subject, caller.name, (Grant(Role.SERVICE),), revision=revision
        )
        return {
            "token": self.keys.signing_key().issue(issued, valid_s=SERVICE_TOKEN_S),
            "expiresInS": SERVICE_TOKEN_S,
        }

    async def look_up(self, subject: str) -> dict[str, Any]:
        """Return the present grants of a user or a token; not active if there is none any more."""
        return await self.read(lambda connection: _looked_up(connection, subject))

    async def introspect(self, token: str) -> dict[str, Any]:
        """Return what is known of a secret token."""
        document = await self.read(lambda connection: secret_token_store.introspected(connection, token))
        if document["active"]:
            self._uses.setdefault(tables.tokens.c.used_s, {})[document["subject"]] = time.time()
        return document


def _looked_up(connection: Connection, subject: str) -> dict[str, Any]:
    revision = revision_of(connection)  # first, so that the grants are never older
    owner = secret_token_store.find_subject(connection, subject)
    if owner is None:
        query = select(tables.users.c.name, tables.users.c.person).where(tables.users.c.subject == subject)
        row = connection.execute(query).mappings().first()
        if row is None:
            return {"active": False, "revision": revision}
        owner = {"kind": CallerKind.USER.value, **row}
    is_service = owner["kind"] == CallerKind.SERVICE
    grants = (Grant(Role.SERVICE),) if is_service else grants_of(connection, subject)
    return {
        "active": True,
        "kind": owner["kind"],
        "subject": subject,
        "name": owner["name"],
        "grants": [{"role": grant.role, "resource": grant.resource} for grant in grants],
        "person": owner.get("person"),
        "session": None,
        "revision": revision,
    }


def _revoked_after(connection: Connection, position: int) -> dict[str, Any]:
    now = revision_of(connection)
    table = tables.revocations
    after = position if position <= now else 0  # the follower knows a database that was replaced by a backup
    query = select(table.c.number, table.c.name).where(table.c.number > after, table.c.number <= now)
    listed = [[number, name] for number, name in connection.execute(query.order_by(table.c.number))]
    return {"position": now, "revoked": listed}
