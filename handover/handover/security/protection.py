"""What a server needs that other machines can reach: TLS and accounts."""

from handover.errors import UsageError
from handover.network.outbound_policy import is_loopback
from handover.security.keys_in_force import KeysInForce
from handover.settings import Settings


def is_reachable_by_others(settings: Settings, host: str) -> bool:
    """Return whether other machines can reach a server on `host`, by itself or through a proxy."""
    return not is_loopback(host) or settings.tls_proxy_url is not None


def require_protection(
    settings: Settings,
    host: str,
    host_setting: str,
    *,
    has_tls: bool | None = None,
    accepts_no_callers: bool = False,
) -> None:
    """Raise `UsageError` if other machines can reach a server on `host` without TLS and accounts.

    A server on loopback needs neither, unless a proxy passes on requests to it. `host_setting` is the setting
    of `host`; `has_tls` says it for a port with settings of TLS of its own. A server that
    `accepts_no_callers` needs no accounts: without their keys it refuses every token, and where
    other machines reach it there is no local mode.
    """
    if not is_reachable_by_others(settings, host):
        return
    if has_tls is None:
        has_tls = settings.tls_certificate is not None or settings.tls_proxy_url is not None
    has_accounts = accepts_no_callers or KeysInForce(settings.security_folder).keys() is not None
    missing = [name for name, is_there in (("TLS", has_tls), ("accounts", has_accounts)) if not is_there]
    if not missing:
        return
    reason = (
        f"HANDOVER_TLS_PROXY_URL is {settings.tls_proxy_url}"
        if is_loopback(host)
        else f"{host_setting} is {host or 'empty'}"
    )
    raise UsageError(
        f"{reason}, so other machines reach this server, and it has no {' and no '.join(missing)}; "
        f"{_remedy(settings, has_tls=has_tls)}, or listen on 127.0.0.1"
        + (" without a proxy" if is_loopback(host) else "")
    )


def _remedy(settings: Settings, *, has_tls: bool) -> str:
    if has_tls:
        return (
            "run `handover secure`, which sets up accounts, or name the directory of their public keys in "
            f"HANDOVER_SECURITY_DIR (now {settings.security_folder})"
        )
    return (
        "run `handover secure`, which makes certificates and accounts, and set HANDOVER_TLS_CERTIFICATE and "
        "HANDOVER_TLS_KEY as it says, or name the proxy that does TLS in HANDOVER_TLS_PROXY_URL"
    )
