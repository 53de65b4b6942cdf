"""Writes the reference pages from the code: settings, commands, REST interfaces, metrics and messages.

python -m docs.site.reference            # write docs/reference/*.md
python -m docs.site.reference --check    # fail if a page is not up to date
"""

import argparse
import ast
import os
import socket
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from pydantic import SecretStr
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from typer.core import TyperGroup

from docs.site.setting_subjects import by_subject
from glove_sdk_bridge.command_line import parser as glove_parser
from handover.command_line.commands import commands_of
from handover.command_line.main import app as command_line
from handover.extensions import Service, application_of
from handover.security.guard import PUBLIC_PATHS, requirements
from handover.security.permissions import Permission, Role
from handover.services import own_services
from handover.settings import PREFIX, Settings
from handover_web.messages import found_messages, python_sources

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "reference"
PACKAGES = ("handover", "services", "ros_fiware_bridge", "webui")
METRIC_TYPES = {"Counter", "Gauge", "Histogram", "Summary"}
WRITTEN_BY = "*Written by `make reference` from the code; do not edit.*"

SETTINGS = f"""\
# Settings

{WRITTEN_BY}

Each setting is an environment variable. A file `.env` in the current folder can hold them too, and a file in
the folder that `HANDOVER_SECRETS_DIR` names can hold a secret. `handover settings` prints the values of this
machine and where each comes from. A cell on one machine needs none of them; the subjects are in the order in
which most cells need them.
"""

CLI = f"""\
# Command line

{WRITTEN_BY}

The options `--help` are left out.
"""

REST = f"""\
# REST interfaces

{WRITTEN_BY}

Every service answers `/healthz`, `/readyz`, `/metrics` and `/context.jsonld`, and shows its interface with
schemas on `/docs`, for which the browser needs no internet. Errors are problem details (RFC 7807). The
context broker answers NGSI-LD; [its
operations](../../services/context_broker/handover_broker/operations.md) have a page of their own.

As long as no account exists, every local caller may do everything. With accounts, a caller sends a token
(`Authorization: Bearer`), and the column *Permission* names what the route asks: a permission, and the
resource for which the caller needs a role that has it. A list concerns everything, so it asks for every
resource.
"""

ROLES = f"""\
# Roles

{WRITTEN_BY}

A grant gives a role for resources ([accounts](../how-to/accounts.md#roles-and-grants)). The table is that of
`handover/handover/security/permissions.py`.

| Role | Name on the page | What it may | Permissions |
|---|---|---|---|
"""

METRICS = f"""\
# Metrics

{WRITTEN_BY}

Prometheus reads them from `/metrics` of each service.

"""

MESSAGES = f"""\
# Codes of errors and reasons

{WRITTEN_BY}

A text that a person reads travels with a code and its parameters (`detailCode`, `reasonCode`), so that a
client can translate it. A code keeps its meaning. The page has the texts in English, German and Finnish.

"""

ALL = own_services()


def main(arguments: Sequence[str] | None = None) -> None:
    """Write or check the pages."""
    parser = argparse.ArgumentParser(prog="python -m docs.site.reference")
    parser.add_argument("--check", action="store_true", help="fail if a page is not up to date")
    options = parser.parse_args(arguments)
    stale = []
    for name, write in WRITERS.items():
        file, text = PAGES / name, "\n".join(write()) + "\n"
        if file.exists() and file.read_text(encoding="utf-8") == text:
            continue
        stale.append(f"docs/reference/{name}")
        if not options.check:
            file.write_text(text, encoding="utf-8")
    if stale and options.check:
        raise SystemExit(f"not up to date: {', '.join(stale)}; write them with: make reference")


def settings_page() -> Iterator[str]:
    """Yield the lines of the page about settings."""
    yield from SETTINGS.splitlines()
    readers: dict[str, list[str]] = {name: ["all services"] for name in Settings.model_fields}
    fields = dict(Settings.model_fields)
    for service in ALL:
        for name, info in service.settings.model_fields.items():
            if name not in Settings.model_fields:
                readers.setdefault(name, []).append(service.name)
                fields.setdefault(name, info)
    for subject, names in by_subject(fields).items():
        yield ""
        yield f"## {subject}"
        yield ""
        yield "| Setting | Default | Meaning | Read by |"
        yield "|---|---|---|---|"
        for name in names:
            info, read_by = fields[name], ", ".join(readers[name])
            shown = f"`{PREFIX}{name.upper()}` | {_default(info)} | {_cell(info.description or '')}"
            yield f"| {shown} | {read_by} |"


def roles_page() -> Iterator[str]:
    """Yield the lines of the page about roles."""
    yield from ROLES.splitlines()
    for role in Role:
        name, may = role.texts["en"]
        permissions = ", ".join(f"`{held}`" for held in Permission if held in role.permissions)
        yield f"| `{role}` | {name} | {may} | {permissions} |"


def cli_page() -> Iterator[str]:
    """Yield the lines of the page about the command line."""
    yield from CLI.splitlines()
    for words, command in commands_of(command_line):
        yield from _command(command, " ".join(("handover", *words)))
    glove = glove_parser("handover glove")
    for action in glove._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, parser in action.choices.items():
                yield from _glove_command(f"handover glove {name}", parser)


def rest_page() -> Iterator[str]:
    """Yield the lines of the page about the REST interfaces."""
    yield from REST.splitlines()
    with tempfile.TemporaryDirectory() as folder:
        os.environ[f"{PREFIX}DATA_DIR"] = folder
        os.environ[f"{PREFIX}GLOVE_PORT"] = str(_free_port())  # the controller opens it with its application
        for service in ALL:
            app = application_of(service)
            if app is not None:
                yield from _routes(service, app)


def metrics_page() -> Iterator[str]:
    """Yield the lines of the page about metrics."""
    yield from METRICS.splitlines()
    yield "| Metric | Type | Labels | Meaning |"
    yield "|---|---|---|---|"
    for name, kind, labels, meaning in sorted(metrics()):
        shown = ", ".join(f"`{label}`" for label in labels)
        yield f"| `{name}` | {kind.lower()} | {shown} | {_cell(meaning)} |"


def messages_page() -> Iterator[str]:
    """Yield the lines of the page about the codes of errors and reasons."""
    yield from MESSAGES.splitlines()
    yield "| Code | Text |"
    yield "|---|---|"
    for code, template in sorted({(found.code, found.template) for found in found_messages()}):
        yield f"| `{code}` | {_cell(template)} |"


WRITERS: Mapping[str, Callable[[], Iterator[str]]] = {
    "settings.md": settings_page,
    "cli.md": cli_page,
    "rest.md": rest_page,
    "roles.md": roles_page,
    "metrics.md": metrics_page,
    "messages.md": messages_page,
}


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _default(info: FieldInfo) -> str:
    value = info.default
    if value is PydanticUndefined:  # made at the start, from other settings
        return "–"
    if value in (None, (), "") or isinstance(value, SecretStr):
        return "–"
    if isinstance(value, tuple):
        value = ",".join(map(str, value))
    return f"`{value}`"


def _command(command: Any, name: str) -> Iterator[str]:
    if not isinstance(command, TyperGroup) or command.help:
        yield ""
        yield f"## `{name}`"
        yield ""
        yield from (command.help or command.short_help or "").strip().splitlines()
    parameters = [one for one in command.params if "--help" not in one.opts]
    if parameters:
        yield ""
        yield "| Argument or option | Default | Meaning |"
        yield "|---|---|---|"
    for parameter in parameters:
        shown = ", ".join(parameter.opts)
        default = parameter.default
        plain = (
            default not in (None, False)
            and not callable(default)
            and "Sentinel" not in type(default).__name__
        )
        meaning = _cell(getattr(parameter, "help", "") or "")
        yield f"| `{shown}` | {f'`{default}`' if plain else ''} | {meaning} |"


def _glove_command(name: str, parser: argparse.ArgumentParser) -> Iterator[str]:
    yield ""
    yield f"## `{name}`"
    yield ""
    yield parser.description or ""
    yield ""
    yield "| Argument or option | Default | Meaning |"
    yield "|---|---|---|"
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        shown = ", ".join(action.option_strings) or action.dest
        default = action.default if action.default not in (None, False, ()) else ""
        meaning = (
            (action.help or "").replace(" (default: %(default)s)", "").replace(" (default: %(default)g)", "")
        )
        meaning = meaning.replace(" (%(default)s)", "").replace(" (%(default)g)", "")
        is_shown = default and action.nargs != 0 and "HANDOVER_" not in meaning
        yield f"| `{shown}` | {f'`{default}`' if is_shown else ''} | {_cell(meaning)} |"


def _routes(service: Service, app: FastAPI) -> Iterator[str]:
    yield ""
    yield f"## {service.name}"
    yield ""
    yield f"`http://127.0.0.1:{service.settings.model_fields[service.port_field].default}`"
    yield ""
    yield "| Method and path | Permission | Meaning |"
    yield "|---|---|---|"
    asked = requirements(app)
    for path, methods in app.openapi()["paths"].items():
        if path in PUBLIC_PATHS:
            continue
        for method, operation in methods.items():
            meaning = operation.get("description") or operation.get("summary", "")
            name = f"{method.upper()} {path}"
            yield f"| `{name}` | {_cell(asked[name])} | {_cell(meaning.partition(chr(10) * 2)[0])} |"
    for name in asked:
        if name.startswith("WebSocket "):
            yield f"| `{name}` | {_cell(asked[name])} | A WebSocket. |"


def metrics() -> Iterator[tuple[str, str, tuple[str, ...], str]]:
    """Yield name, type, labels and meaning of each metric that the code defines."""
    for package in PACKAGES:
        for path in python_sources(ROOT / package):
            source = path.read_text(encoding="utf-8")
            if "prometheus_client" in source:
                yield from _metrics_in(source)


def _metrics_in(source: str) -> Iterator[tuple[str, str, tuple[str, ...], str]]:
    for node in ast.walk(ast.parse(source)):
        if not (
            isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in METRIC_TYPES
        ):
            continue
        given = [
            ast.literal_eval(one) for one in node.args if isinstance(one, ast.Constant | ast.List | ast.Tuple)
        ]
        given += [ast.literal_eval(one.value) for one in node.keywords if one.arg == "labelnames"]
        if len(given) >= 2 and str(given[0]).startswith("handover_"):
            labels = tuple(given[2]) if len(given) > 2 else ()
            yield given[0], node.func.id, labels, given[1]


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


if __name__ == "__main__":
    main()
