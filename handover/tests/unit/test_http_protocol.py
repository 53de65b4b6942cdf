"""What we rely on of uvicorn, which is no public API."""

import tomllib
from importlib.metadata import version

from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle
from uvicorn.server import ServerState

from tests.kit.paths import REPOSITORY

TESTED = (0, 54)
"""The newest uvicorn that was tested; for another one run the tests, raise the bound and this."""


def test_uvicorn_is_bounded_by_the_version_that_was_tested() -> None:
    wanted = tomllib.loads((REPOSITORY / "handover/pyproject.toml").read_text())["project"]["dependencies"]
    (wanted,) = [one for one in wanted if one.startswith("uvicorn>")]
    assert f"<0.{TESTED[1] + 1}" in wanted
    assert tuple(map(int, version("uvicorn").split(".")[:2])) <= TESTED


def test_uvicorn_has_what_our_protocols_override() -> None:
    for name in (
        "connection_made",
        "connection_lost",
        "data_received",
        "on_message_begin",
        "on_header",
        "on_headers_complete",
        "on_body",
        "on_message_complete",
        "on_response_complete",
        "resume_writing",
        "handle_websocket_upgrade",
        "_start_asgi_task",
    ):
        assert callable(getattr(HttpToolsProtocol, name)), name
    assert {"connections", "default_headers", "total_requests"} <= set(vars(ServerState()))
    assert {"pause_reading", "resume_reading"} <= set(dir(FlowControl))
    assert {"run_asgi", "receive", "send"} <= set(dir(RequestResponseCycle))
