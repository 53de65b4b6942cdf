"""Serving: runs the application of a service until SIGTERM or Ctrl-C, without importing a web framework."""

import asyncio
import errno
import os
import signal
import socket
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import uvicorn
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from handover.errors import UsageError
from handover.files.folder_lock import serve_alone
from handover.files.private_files import UMASK, make_private
from handover.http.origin_guard import OriginGuard, OriginPolicy
from handover.http.protocol import KEEP_ALIVE_S, Connections, HttpProtocol
from handover.runtime.ports import hold_when_free
from handover.security.protection import require_protection
from handover.security.service_access import has_component_token
from handover.serving.certificate_watch import CertificateWatch
from handover.settings import LIFELINE, PREFIX, Settings
from handover.telemetry import get_logger, set_up_logging
from handover.transport_security.server_certificate import ServerCertificate
from handover.transport_security.tls_listener import listen

log = get_logger(__name__)

_DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})

SomeSettings = TypeVar("SomeSettings", bound=Settings)


def run(
    service: str,
    make_app: Callable[[SomeSettings], ASGIApp],
    settings_class: type[SomeSettings],
    *,
    port_field: str,
) -> None:
    """Run a service until it is stopped; `port_field` is the setting of its port.

    Exits with 2 and one line when it cannot start with its settings.
    """
    try:
        settings = settings_class.load()
    except UsageError as error:
        raise SystemExit(_in_one_line(service, error)) from None
    serve(
        lambda: make_app(settings),
        settings,
        service=service,
        port=getattr(settings, port_field),
        port_setting=f"{PREFIX}{port_field}".upper(),
    )


def serve(
    make_app: Callable[[], ASGIApp],
    settings: Settings,
    *,
    service: str,
    port: int,
    port_setting: str,
    urls: Sequence[str] = (),
    is_component: bool = False,
) -> None:
    """Serve the application of `make_app` on `port` until stopped; exits as `run` does.

    `urls` are further addresses of the server, in addition to those in the settings. A component of others
    that has its token may be on a machine without the keys of accounts.
    """
    try:
        set_up_logging(settings, service)
        require_protection(
            settings,
            settings.host,
            "HANDOVER_HOST",
            accepts_no_callers=is_component and has_component_token(settings),
        )
        os.umask(UMASK)
        require_writable(settings.data_dir)
        if os.environ.get(LIFELINE):  # before a wait for the holder of the databases
            threading.Thread(target=_end_with_parent, daemon=True).start()
        ServerCertificate.of(settings)  # one that cannot be used is refused now, not at the end of a standby
        serve_alone(settings, service, log.warning)
        for line in make_private(settings.data_dir):
            log.warning("private files", what=line)
        certificate = ServerCertificate.of(settings)
        # Reserved until the server listens: otherwise a connection of the service itself could get the port.
        held_port = hold_when_free(settings.host, port, port_setting, say=log.warning)
        made = make_app()
        policy = OriginPolicy.of(settings, urls)
        application = _StartupErrors(OriginGuard(made, policy))
    except (UsageError, OSError) as error:
        raise SystemExit(_in_one_line(service, error)) from None
    config = uvicorn.Config(
        behind_proxies(application, settings),
        host=settings.host,
        port=port,
        log_config=None,
        access_log=False,
        timeout_graceful_shutdown=1,
        timeout_keep_alive=int(KEEP_ALIVE_S),
        server_header=False,
        proxy_headers=False,  # uvicorn trusts every program of this machine by default
        http=_protocol(made, policy, Connections(settings)),
    )
    watch = None if certificate is None else CertificateWatch(certificate, settings, service)
    server = Server(config, settings, certificate, watch)
    try:
        with held_port, suppress(KeyboardInterrupt):  # uvicorn has already shut down after Ctrl-C
            server.run()
    except SystemExit:  # uvicorn exits so after a failed start, without the reason
        if application.why is None:
            raise
    if application.why is not None:
        raise SystemExit(_in_one_line(service, application.why))
    if not server.started:
        raise SystemExit(1)


def behind_proxies(application: ASGIApp, settings: Settings) -> ASGIApp:
    """Return `application` with the client's address and scheme from the headers of trusted proxies."""
    if not settings.trusted_proxies:
        return application
    return cast("ASGIApp", ProxyHeadersMiddleware(cast("Any", application), list(settings.trusted_proxies)))


class Server(uvicorn.Server):
    """A uvicorn server with a listener of ours: with TLS its certificate is watched.

    `startup` with sockets, and `servers`, are no public API of uvicorn: pyproject.toml bounds its
    version, and a test names it.
    """

    def __init__(
        self,
        config: uvicorn.Config,
        settings: Settings,
        certificate: ServerCertificate | None,
        watch: CertificateWatch | None,
    ) -> None:
        super().__init__(config)
        self._settings = settings
        self._certificate = certificate
        self._watch = watch
        self._watching: asyncio.Task[None] | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:  # noqa: ARG002 - see above
        """Start the application, then listen."""
        await super().startup(sockets=[])
        config = self.config
        try:
            listener = await listen(
                self._make_protocol,
                config.host,
                config.port,
                self._certificate,
                handshake_timeout_s=self._settings.tls_handshake_timeout_s,
                backlog=config.backlog,
            )
        except OSError as error:
            log.critical("cannot listen", host=config.host, port=config.port, error=error.strerror)
            await self.lifespan.shutdown()
            raise SystemExit(1) from None
        self.servers = cast("list[asyncio.Server]", [listener])
        if self._watch is not None:
            self._watching = asyncio.create_task(self._watch.run())

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop to watch the certificate, and shut down."""
        if self._watching is not None:
            self._watching.cancel()
        await super().shutdown(sockets)

    def _make_protocol(self) -> asyncio.Protocol:
        make: Any = self.config.http_protocol_class
        made: asyncio.Protocol = make(
            config=self.config, server_state=self.server_state, app_state=self.lifespan.state
        )
        return made


def _protocol(made: ASGIApp, policy: OriginPolicy, connections: Connections) -> Any:
    """Return the HTTP protocol; the own protocol of an application applies `policy` itself."""
    own = getattr(made, "protocol", None)
    if own is None:
        return partial(HttpProtocol, connections=connections)
    return partial(own, policy=policy, connections=connections)


def require_writable(folder: Path) -> None:
    """Create the data directory; raise `UsageError` in one line when it is not writable.

    A full disk is only logged: existing data can still be read, and the service reports failed writes.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        if error.errno in _DISK_FULL and folder.is_dir():
            log.warning("the disk is full", directory=str(folder), error=error.strerror)
            return
        who = f" by user {os.getuid()}" if hasattr(os, "getuid") else ""
        raise UsageError(
            f"the data directory {folder.absolute()} cannot be written{who}: {error.strerror}; "
            "make it writable or set HANDOVER_DATA_DIR to another directory"
        ) from None


class _StartupErrors:
    """Catches a `UsageError` of the start, so that it is shown in one line, without a traceback."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self.why: UsageError | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "lifespan":
            await self._app(scope, receive, send)
            return
        failure: Message | None = None

        async def hold_failure(message: Message) -> None:
            nonlocal failure
            if message["type"] == "lifespan.startup.failed":
                failure = message
            else:
                await send(message)

        try:
            await self._app(scope, receive, hold_failure)
        except UsageError as error:
            self.why = error
            await send({"type": "lifespan.startup.failed", "message": ""})
        except BaseException:
            if failure is not None:
                await send(failure)
            raise


def _in_one_line(service: str, error: Exception) -> int:
    print(f"{service}: {error}", file=sys.stderr)  # noqa: T201 - the one line a person reads
    return 2


def _end_with_parent() -> None:
    while os.read(
        sys.stdin.fileno(), 4096
    ):  # without the lock of sys.stdin, for which an early exit would wait
        pass
    os.kill(os.getpid(), signal.SIGTERM)
