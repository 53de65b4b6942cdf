"""Serving: how the application of a service is run, until SIGTERM or Ctrl-C.

Nothing here needs a web framework: a service that starts quickly need not load one first.
"""

import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

import uvicorn
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from handover.errors import UsageError
from handover.ports import require_free
from handover.settings import LIFELINE, PREFIX, Settings
from handover.telemetry import get_logger, set_up_logging

log = get_logger(__name__)

KEEP_ALIVE_S = 75
"""Longer than clients keep idle connections (httpx: 5 s), so that they never write to one that is closing."""

SomeSettings = TypeVar("SomeSettings", bound=Settings)


def run(
    service: str,
    make_app: Callable[[SomeSettings], ASGIApp],
    settings_class: type[SomeSettings],
    *,
    port_field: str,
) -> None:
    """Run a service until it is told to stop; `port_field` is the setting that says where it listens.

    Exits with 2 and one line when it cannot start as it is set.
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
    make_app: Callable[[], ASGIApp], settings: Settings, *, service: str, port: int, port_setting: str
) -> None:
    """Serve what `make_app` makes on `port` until told to stop; exits as `run` does."""
    try:
        set_up_logging(settings, service)
        require_free(settings.host, port, port_setting, say=log.warning)
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        made = make_app()
        application = _SaysWhy(made)
    except (UsageError, OSError) as error:
        raise SystemExit(_in_one_line(service, error)) from None
    if os.environ.get(LIFELINE):
        threading.Thread(target=_end_with_parent, daemon=True).start()
    server = uvicorn.Server(
        uvicorn.Config(
            application,
            host=settings.host,
            port=port,
            log_config=None,
            access_log=False,
            timeout_graceful_shutdown=1,
            timeout_keep_alive=KEEP_ALIVE_S,
            server_header=False,
            http=getattr(made, "protocol", "auto"),  # an application may bring a shorter way in
        )
    )
    try:
        with suppress(KeyboardInterrupt):  # Ctrl-C has stopped it in good order by now
            server.run()
    except SystemExit:  # so it ends when the start has failed, and would take the reason along
        if application.why is None:
            raise
    if application.why is not None:
        raise SystemExit(_in_one_line(service, application.why))
    if not server.started:
        raise SystemExit(1)


class _SaysWhy:
    """Keeps what makes the start fail, if it is for a person to mend, from being told as a traceback."""

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
    while sys.stdin.buffer.read(4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
