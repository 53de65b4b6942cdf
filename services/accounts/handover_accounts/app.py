"""The accounts service: people, roles and grants, sessions, tokens, revocations, and the audit log."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from handover.security.audit_reading.audit_routes import add_audit_routes
from handover.security.authentication import Guard
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover_accounts.directory import Directory
from handover_accounts.names import AccountsAudit, subject_names
from handover_accounts.openid_connect.provider_sign_in import ProviderSignIn
from handover_accounts.routes.own_routes import add_own_routes
from handover_accounts.routes.people_routes import (
    add_invitation_routes,
    add_token_routes,
    add_user_routes,
)
from handover_accounts.routes.provider_routes import add_provider_routes
from handover_accounts.routes.service_routes import add_page_server_routes, add_service_routes
from handover_accounts.routes.station_routes import add_station_routes
from handover_accounts.settings import AccountsSettings


def make_app(settings: AccountsSettings) -> FastAPI:
    """Return the application; raise `UsageError` if it cannot work with these settings."""
    directory = Directory(settings)
    guard = Guard(settings, "accounts", revocations=directory.revocations, introspect=directory.introspect)

    provider = ProviderSignIn(directory)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with directory:
            yield
        provider.close()

    app = create_app(
        "Accounts",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={"storage": storage_check(settings.data_dir)},
        guard=guard,
    )
    app.state.directory = directory
    add_service_routes(app, directory)
    add_page_server_routes(app, directory)
    add_provider_routes(app, provider)
    add_own_routes(app, directory)
    add_station_routes(app, directory)
    add_user_routes(app, directory)
    add_invitation_routes(app, directory)
    add_token_routes(app, directory)
    add_audit_routes(app, AccountsAudit(directory), subject_names)
    return app
