"""`handover glove`: tokens of gloves, and the arguments of the glove bridge from our settings."""

import os
from collections.abc import Sequence
from urllib.parse import quote

import typer

from glove_sdk_bridge.controller_client import ACCESS_TOKEN
from glove_sdk_bridge.sources import source_kinds
from handover.command_line.access import ask_service, cli_access
from handover.command_line.waiting import wait_for_secrets, wait_for_security
from handover.errors import UsageError
from handover_gloves.settings import ControllerSettings

app = typer.Typer()

TALKS_TO = {
    "forward": ("host", "port"),
    "replay": ("host", "port"),
    "serial": ("host", "port"),
    "simulate": ("host", "port", "controller"),
    "record": ("controller",),
    "calibrate": ("controller",),
}


def bridge_arguments(arguments: Sequence[str]) -> list[str]:
    """Return the arguments of the user after those from `HANDOVER_…` and `.env`.

    The bridge does not read our settings, since it is a separate program. The last of two equal options
    counts, so the user overrides the settings.
    """
    if not arguments or arguments[0] not in {*TALKS_TO, *source_kinds()}:
        return list(arguments)
    settings = ControllerSettings.load()
    if settings.token is not None and not os.environ.get("HANDOVER_GLOVE_TOKEN"):
        os.environ["HANDOVER_GLOVE_TOKEN"] = settings.token
    access_token = cli_access(settings).secret_token()
    if access_token is not None:
        os.environ[ACCESS_TOKEN] = access_token
    codes = {
        "host": {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(settings.glove_host, settings.glove_host),  # noqa: S104
        "port": str(settings.glove_port),
        "controller": settings.gesture_controller,
    }
    if settings.tls_authority is not None:
        os.environ["HANDOVER_TLS_AUTHORITY"] = str(settings.tls_authority)
    command, *options = arguments
    names = TALKS_TO.get(command, ("host", "port"))
    from_settings = [part for name in names for part in (f"--{name}", codes[name])]
    if "port" in names and settings.expects_tls(settings.glove_host):
        from_settings.append("--tls")
    return [command, *from_settings, *options]


def change_token(words: Sequence[str]) -> None:
    """Create and show a token for a glove, or remove it; the arguments are NAME or NAME --remove."""
    remove = "--remove" in words
    names = [word for word in words if word != "--remove"]
    if len(names) != 1 or names[0].startswith("-"):
        raise UsageError("name the glove: handover glove token NAME, or handover glove token NAME --remove")
    settings = ControllerSettings.load()
    controller = settings.gesture_controller
    path = f"/gloves/{quote(names[0], safe='')}/token"
    method = "DELETE" if remove else "PUT"
    answer = ask_service("gesture controller", settings, method, controller, path)
    if remove:
        print(f"{names[0]} has no token any more")
        return
    print(f"The token of {names[0]} (it is shown only once):")
    print(str(answer.json()["token"]))
    print("Give it to the glove as HANDOVER_GLOVE_TOKEN; it connects with this token only.")


@app.command(
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
)
def glove(context: typer.Context) -> None:
    """Run the glove bridge: forward, serial, replay, record, simulate, calibrate; or manage a token."""
    if context.args[:1] == ["token"]:
        change_token(context.args[1:])
        return
    from glove_sdk_bridge.__main__ import main as bridge  # noqa: PLC0415 - only this command needs it

    wait_for_secrets(("glove_token",))
    wait_for_security()
    raise typer.Exit(bridge(bridge_arguments(context.args), program="handover glove"))
