"""The command line: source, glove and address of the controller."""

import argparse
import os
from pathlib import Path
from typing import NoReturn

from glove_sdk_bridge.arguments import add_controller, glove_name, port, positive
from glove_sdk_bridge.errors import BridgeError
from glove_sdk_bridge.frames import HANDS
from glove_sdk_bridge.sources import source_kinds
from glove_sdk_bridge.tls import AUTHORITY

TOKEN = "HANDOVER_GLOVE_TOKEN"  # noqa: S105 - the name of a setting, no secret


class _Parser(argparse.ArgumentParser):
    """A parser that reports an error in one line."""

    def error(self, message: str) -> NoReturn:
        raise BridgeError(f"{self.prog}: {message}; {self.prog} --help explains it")


def parse(words: list[str], program: str) -> argparse.Namespace:
    """Return the parsed arguments; raise `BridgeError` if they are invalid, SystemExit for --help."""
    return parser(program).parse_args(words)


def parser(program: str) -> argparse.ArgumentParser:
    """Return the parser of the command line, with one sub-parser for each command."""
    parser = _Parser(
        prog=program, description="Sends the frames of a glove to the gesture controller.", allow_abbrev=False
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, summary: str, *parents: _Parser) -> argparse.ArgumentParser:
        return commands.add_parser(
            name, help=summary, description=summary, parents=parents, allow_abbrev=False
        )

    glove, connection = _glove_arguments(), _connection_arguments()
    for name, kind in source_kinds().items():
        kind.add_arguments(add(name, kind.summary, glove, connection))
    _record_arguments(add("record", "Write what a connected glove sends to a file.", glove))
    _calibrate_arguments(
        add("calibrate", "Calibrate a glove for its wearer: a fist, then an open hand.", glove)
    )
    return parser


def _glove_arguments() -> _Parser:
    words = _Parser(add_help=False)
    words.add_argument(
        "--glove", default="glove-1", type=glove_name, help="name of the glove (default: %(default)s)"
    )
    return words


def _connection_arguments() -> _Parser:
    words = _Parser(add_help=False)
    words.add_argument("--hand", choices=HANDS, help="the hand that wears it (default: right)")
    words.add_argument(
        "--host", default="127.0.0.1", help="address of the glove server (default: %(default)s)"
    )
    words.add_argument("--port", default=54000, type=port, help="its TCP port (default: %(default)s)")
    words.add_argument(
        "--tls",
        action=argparse.BooleanOptionalAction,
        default=False,
        help=f"connect with TLS; {AUTHORITY} names a file of authorities to trust (PEM)",
    )
    words.add_argument(
        "--token",
        default=os.environ.get(TOKEN, ""),
        help=f"the token of the glove; better in {TOKEN}, where other users cannot see it",
    )
    return words


def _record_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, help="where to write; an existing recording is continued")
    add_controller(parser)
    parser.add_argument("--seconds", type=positive, help="stop after this time (default: on Ctrl-C)")


def _calibrate_arguments(parser: argparse.ArgumentParser) -> None:
    add_controller(parser)
    parser.add_argument("--from", dest="table", type=Path, help="a table of poses (CSV) instead of the hand")
    parser.add_argument("--fist", default="0", metavar="POSE", help="its pose of a fist (%(default)s)")
    parser.add_argument("--open", default="5", metavar="POSE", help="its pose of an open hand (%(default)s)")
    parser.add_argument(
        "--seconds", type=positive, default=1.0, help="how much of each pose is taken (%(default)g)"
    )
