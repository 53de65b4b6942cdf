"""Signing in and out at the provider: the use cases, above the directory."""

from collections.abc import Mapping
from typing import Any

from sqlalchemy import Connection

from handover.errors import Problem
from handover.telemetry import get_logger
from handover_accounts.directory import NOBODY, Directory
from handover_accounts.metrics import SIGN_INS
from handover_accounts.openid_connect import identities
from handover_accounts.openid_connect.claims import name_of, role_mapping
from handover_accounts.openid_connect.provider import OpenIdProvider, ProvenIdentity, ProviderError
from handover_accounts.storage import sessions, users
from handover_accounts.storage.changes import Change

log = get_logger(__name__)

METHOD = "openid"


class ProviderSignIn:
    """Signs people in who have identified at the provider; raises `UsageError` for invalid settings."""

    def __init__(self, directory: Directory) -> None:
        settings = directory.settings
        self._directory = directory
        self._settings = settings
        self._roles = role_mapping(settings.oidc_roles_claim, settings.oidc_roles)
        self._provider = None if settings.oidc_issuer is None else OpenIdProvider(settings)

    def close(self) -> None:
        """Close the connections."""
        if self._provider is not None:
            self._provider.close()

    @property
    def name(self) -> str | None:
        """The name of the provider; None without one."""
        return None if self._provider is None else self._settings.oidc_name

    def _known(self) -> OpenIdProvider:
        self._directory.require_accounts()
        if self._provider is None:
            raise Problem(
                409,
                "No provider",
                "there is no OpenID Connect provider; set HANDOVER_OIDC_ISSUER to have one",
            )
        return self._provider

    async def begin(self, redirect_uri: str, address: str) -> dict[str, Any]:
        """Begin to sign in: where the browser goes, and the secret that it brings back."""
        provider = self._known()
        self._directory.admit_attempt(address, "provider")
        secret, request = await self._directory.change(
            NOBODY, lambda change: identities.begin(change, redirect_uri)
        )
        try:
            location = await provider.location(request)
        except ProviderError as error:
            raise _unavailable(error) from None
        return {"location": location, "secret": secret, "maxAgeS": int(identities.SIGN_IN_VALID_S)}

    async def finish(self, answer: identities.BrowserAnswer, address: str, device: str) -> dict[str, Any]:
        """Open a session for the person who has signed in. Raises `Problem` 403, 409, 422, 503."""
        provider = self._known()
        request = await self._directory.change(
            NOBODY, lambda change: identities.finish(change, answer.secret, answer.state)
        )
        try:
            identity = await provider.identity(request, answer.code, answer.iss)
        except ProviderError as error:
            SIGN_INS.labels("refused").inc()
            raise _unavailable(error) from None

        def opened(change: Change) -> str:
            subject = self._user(change, identity)
            change.actor = subject
            identities.set_grants(change, subject, self._roles.grants_of(identity.claims))
            session, token = sessions.open_session(
                change, subject, method=METHOD, address=address, device=device
            )
            identities.keep_id_token(change, session, identity.id_token)
            return token

        token = await self._directory.change(NOBODY, opened, method=METHOD)
        self._directory.sign_in_succeeded(address, "provider")
        SIGN_INS.labels("accepted").inc()
        return {"session": token, "maxAgeS": int(self._directory.session_limits.max_s)}

    def _user(self, change: Change, identity: ProvenIdentity) -> str:
        subject = identities.user_of(change.connection, identity.issuer, identity.subject)
        if subject is not None:
            return subject
        if not self._settings.oidc_create_users:
            raise Problem(
                403,
                "No account",
                f"you have no account here yet; ask an admin to connect one with your id at "
                f"{self._settings.oidc_name}: {identity.subject[:100]}",
            )
        name = name_of(identity.claims)
        if not identities.is_name_free(change.connection, users.name_key(name)):
            raise Problem(
                409,
                "Name in use",
                f'there is another account "{name}"; if it is yours, ask an admin to connect it with your id '
                f"at {self._settings.oidc_name}: {identity.subject[:100]}",
            )
        subject = users.add_user(change, name, None)
        identities.set_identity(change, subject, identity.issuer, identity.subject)
        return subject

    async def set_identity(self, actor: str, subject: str, provider_subject: str | None) -> None:
        """Connect a user with a subject of the provider, or with none. Raises `Problem` 404, 409."""
        self._known()
        issuer = await self._issuer()

        def change_identity(change: Change) -> None:
            users.find(change.connection, subject)
            identities.set_identity(change, subject, issuer, provider_subject)

        await self._directory.change(actor, change_identity)

    async def _issuer(self) -> str:
        try:
            return str((await self._known().metadata())["issuer"])
        except ProviderError as error:
            raise _unavailable(error) from None

    async def end_session(self, token: str, return_to: str | None, pin: str | None = None) -> str | None:
        """Sign out; return where the browser signs out at the provider, if the session began there.

        Raises `Problem` 403 for a station without a `pin` that may sign it out, 429.
        """
        await self._directory.admit_sign_out(token, pin)

        def proof(connection: Connection) -> str | None:
            row: Mapping[str, Any] | None = sessions.find_session(
                connection, token, self._directory.session_limits
            )
            return None if row is None else identities.id_token_of(connection, row["id"])

        id_token = await self._directory.read(proof)
        await self._directory.end_session(token)
        if id_token is None or return_to is None or self._provider is None:
            return None
        try:
            return await self._provider.sign_out_location(id_token, return_to)
        except ProviderError as error:
            log.warning("the provider does not answer; the session there remains", reason=str(error))
            return None


def _unavailable(error: ProviderError) -> Problem:
    log.warning("sign-in at the provider failed", reason=str(error))
    return Problem(503, "Provider failed", f"signing in at the provider failed: {error}")
