"""The settings of accounts, in addition to the common ones."""

from pathlib import Path

from pydantic import Field, SecretStr

from handover.extensions import Service
from handover.service_addresses import ACCOUNTS
from handover.settings import SIGNING_KEYS_FILE, MaybePath, Names, Settings


class AccountsSettings(Settings):
    """How long sessions, links and audit records last, and how many passwords are checked at once."""

    session_idle_h: float = Field(
        12.0, gt=0, le=8760, description="a session ends after so many hours without a request"
    )
    session_bound: bool = Field(
        False,
        description="a session is of use only from the network of its sign-in (an IPv4 address, an IPv6 "
        "/64), so that a stolen cookie is of none elsewhere; after a change of the network a new sign-in is "
        "necessary",
    )
    session_max_h: float = Field(
        168.0, gt=0, le=8760, description="a session ends so many hours after the sign-in, in any case"
    )
    link_valid_h: float = Field(
        72.0,
        gt=0,
        le=8760,
        description="an invitation or a link for a new password expires after so many hours",
    )
    password_workers: int = Field(
        2,
        ge=1,
        le=64,
        description="passwords checked at the same time; each takes 64 MiB while it is checked",
    )

    oidc_issuer: str | None = Field(
        None,
        description="the issuer (URL) of an OpenID Connect provider; with it people may sign in there too",
    )
    oidc_client_id: str = Field("handover", description="our client id at the provider")
    oidc_client_secret: SecretStr | None = Field(
        None, description="our client secret at the provider; a public client has none"
    )
    oidc_name: str = Field("OpenID Connect", max_length=40, description="the provider on the sign-in button")
    oidc_scopes: str = Field("openid profile email", description="the scopes that are asked for, with spaces")
    oidc_roles_claim: str = Field(
        "groups", description="the claim that has roles: a name, or a path such as realm_access.roles"
    )
    oidc_roles: Names = Field(
        (),
        description="value=role or value=role@resource with commas: which values of the claim give which "
        "grants; they follow the provider with each sign-in",
    )
    oidc_create_users: bool = Field(
        False, description="make an account at the first sign-in; otherwise an admin connects an account"
    )
    oidc_metadata_file: MaybePath = Field(
        None, description="a JSON file with the metadata of a provider that has no discovery (Keyrock)"
    )
    oidc_token_secret: SecretStr | None = Field(
        None, description="the secret with which the provider signs ID tokens (HS256), instead of its keys"
    )
    oidc_nonce: bool = Field(
        True, description="require the nonce in ID tokens; false for a provider without it (Keyrock)"
    )

    @property
    def identifier_key_file(self) -> Path:
        """The file of the key of identifiers, which only accounts reads."""
        return self.data_dir / "accounts-identifier-key"

    @property
    def signing_keys_file(self) -> Path:
        """The file of the private keys, which only accounts reads."""
        return self.data_dir / SIGNING_KEYS_FILE


SERVICE = Service(ACCOUNTS, "handover_accounts", AccountsSettings, "accounts_port")
