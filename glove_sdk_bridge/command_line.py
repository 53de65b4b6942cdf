"""The words of the command line: which source, which glove, where the controller is."""

import argparse
import os
from pathlib import Path
from typing import NoReturn

from glove_sdk_bridge.arguments import add_controller, glove_name, port, positive
from glove_sdk_bridge.errors import BridgeError
from glove_sdk_bridge.frames import HANDS
from glove_sdk_bridge.sources import source_kinds

TOKEN = "HANDOVER_GLOVE_TOKEN"  # noqa: S105 - the name of a setting, no secret


class _Parser(argparse.ArgumentParser):
    """A parser that says in one line what is wrong."""

    def error(self, message: str) -> NoReturn:
        raise BridgeError(f"{self.prog}: {message}; {self.prog} --help explains it")


def parse(words: list[str], program: str) -> argparse.Namespace:
    """Return what `words` ask for; raise `BridgeError` if they make no sense, SystemExit for --help."""
    return parser(program).parse_args(words)


def parser(program: str) -> argparse.ArgumentParser:
    """Return the parser of the command line, with one sub-parser for each command."""
    parser = _Parser(
        prog=program, description="A glove becomes frames for the gesture controller.", allow_abbrev=False
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, summary: str, *parents: _Parser) -> argparse.ArgumentParser:
        return commands.add_parser(
            name, help=summary, description=summary, parents=parents, allow_abbrev=False
        )

    glove, link = _glove_words(), _link_words()
    for name, kind in source_kinds().items():
        kind.add_arguments(add(name, kind.summary, glove, link))
    _record_words(add("record", "Write what a connected glove sends to a file.", glove))
    _calibrate_words(add("calibrate", "Fit a glove to its wearer: a fist, then an open hand.", glove))
    return parser


def _glove_words() -> _Parser:
    words = _Parser(add_help=False)
    words.add_argument(
        "--glove", default="glove-1", type=glove_name, help="name of the glove (default: %(default)s)"
    )
    return words


def _link_words() -> _Parser:
    words = _Parser(add_help=False)
    words.add_argument("--hand", choices=HANDS, help="the hand that wears it (default: right)")
    words.add_argument("--host", default="127.0.0.1", help="where the controller awaits gloves (%(default)s)")
    words.add_argument("--port", default=54000, type=port, help="its TCP port (default: %(default)s)")
    words.add_argument(
        "--token",
        default=os.environ.get(TOKEN, ""),
        help=f"the secret that lets gloves in; better in {TOKEN}, where other users cannot see it",
    )
    return words


def _record_words(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, help="where to write; an existing recording is continued")
    add_controller(parser)
    parser.add_argument("--seconds", type=positive, help="stop after so long (default: with Ctrl-C)")


def _calibrate_words(parser: argparse.ArgumentParser) -> None:
    add_controller(parser)
    parser.add_argument("--from", dest="table", type=Path, help="a table of poses (CSV) instead of the hand")
    parser.add_argument("--fist", default="0", metavar="POSE", help="its pose of a fist (%(default)s)")
    parser.add_argument("--open", default="5", metavar="POSE", help="its pose of an open hand (%(default)s)")
    parser.add_argument(
        "--seconds", type=positive, default=1.0, help="how much of each pose is taken (%(default)g)"
    )
