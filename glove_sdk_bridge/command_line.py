"""The words of the command line: which source, which glove, where the controller is."""

import argparse
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from glove_sdk_bridge.errors import BridgeError
from glove_sdk_bridge.frames import HANDS, is_glove_name
from glove_sdk_bridge.replay import RATE_HZ
from glove_sdk_bridge.serial_port import BAUD, FULL_SCALE
from glove_sdk_bridge.simulated_hand import RATE_HZ as HAND_RATE_HZ

TOKEN = "HANDOVER_GLOVE_TOKEN"  # noqa: S105 - the name of a setting, no secret
CONTROLLER = "http://127.0.0.1:54210"


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
    add(
        "forward",
        'Frames on standard input, one a line: five numbers with commas, {"bend":[…]} or a whole frame.',
        glove,
        link,
    )
    _replay_words(add("replay", "Play a recording (JSON lines) or a table of poses (CSV).", glove, link))
    _serial_words(add("serial", "Read a glove on a serial port: OpenGloves or five numbers.", glove, link))
    _simulate_words(add("simulate", "A simulated operator does what the Tasks ask for.", glove, link))
    _record_words(add("record", "Write what a connected glove sends to a file.", glove))
    _calibrate_words(add("calibrate", "Fit a glove to its wearer: a fist, then an open hand.", glove))
    return parser


def _glove_words() -> _Parser:
    words = _Parser(add_help=False)
    words.add_argument(
        "--glove", default="glove-1", type=_glove, help="name of the glove (default: %(default)s)"
    )
    return words


def _link_words() -> _Parser:
    words = _Parser(add_help=False)
    words.add_argument("--hand", choices=HANDS, help="the hand that wears it (default: right)")
    words.add_argument("--host", default="127.0.0.1", help="where the controller awaits gloves (%(default)s)")
    words.add_argument("--port", default=54000, type=_port, help="its TCP port (default: %(default)s)")
    words.add_argument(
        "--token",
        default=os.environ.get(TOKEN, ""),
        help=f"the secret that lets gloves in; better in {TOKEN}, where other users cannot see it",
    )
    return words


def _replay_words(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, help="recording (.jsonl) or table (.csv)")
    parser.add_argument(
        "--pose", type=_poses, default=(), metavar="N[,N]", help="only these poses of a table"
    )
    parser.add_argument(
        "--rate", type=_positive, default=RATE_HZ, help="frames a second of a table (default: %(default)g)"
    )
    parser.add_argument(
        "--speed", type=_positive, default=1.0, help="times as fast as recorded; frames keep their own time"
    )
    parser.add_argument("--loop", action="store_true", help="again and again")


def _serial_words(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("device", help="serial port, such as /dev/ttyUSB0 or COM3")
    parser.add_argument("--baud", type=_count, default=BAUD, help="bits a second (default: %(default)s)")
    parser.add_argument(
        "--invert", action="store_true", help="the values fall when a finger is stretched (most OpenGloves)"
    )
    parser.add_argument(
        "--full-scale",
        type=_count,
        default=FULL_SCALE,
        metavar="N",
        help="with --invert: the largest value (default: %(default)s)",
    )


def _simulate_words(parser: argparse.ArgumentParser) -> None:
    _controller_word(parser)
    parser.add_argument(
        "--rate", type=_rate, default=HAND_RATE_HZ, help="frames a second (default: %(default)g)"
    )
    parser.add_argument("--seed", type=int, help="the same seed moves the hand in the same way")
    parser.add_argument(
        "--mistakes", type=_share, default=0.15, help="share of attempts that go wrong (default: %(default)g)"
    )
    parser.add_argument("--speed", type=_positive, default=1.0, help="times as quick as a person")
    parser.add_argument(
        "--no-calibrate", dest="calibrate", action="store_false", help="use the thresholds that are there"
    )


def _record_words(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, help="where to write; an existing recording is continued")
    _controller_word(parser)
    parser.add_argument("--seconds", type=_positive, help="stop after so long (default: with Ctrl-C)")


def _calibrate_words(parser: argparse.ArgumentParser) -> None:
    _controller_word(parser)
    parser.add_argument("--from", dest="table", type=Path, help="a table of poses (CSV) instead of the hand")
    parser.add_argument("--fist", default="0", metavar="POSE", help="its pose of a fist (%(default)s)")
    parser.add_argument("--open", default="5", metavar="POSE", help="its pose of an open hand (%(default)s)")
    parser.add_argument(
        "--seconds", type=_positive, default=1.0, help="how much of each pose is taken (%(default)g)"
    )


def _controller_word(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--controller", default=CONTROLLER, help="URL of the controller (default: %(default)s)"
    )


def _glove(text: str) -> str:
    if not is_glove_name(text):
        raise argparse.ArgumentTypeError('a glove is named by 1 to 64 letters, digits, ".", "_" or "-"')
    return text


def _poses(text: str) -> tuple[str, ...]:
    poses = tuple(part.strip() for part in text.split(","))
    if not all(poses):
        raise argparse.ArgumentTypeError(f"{text!r} is no list of poses such as 1,2,8")
    return poses


def _checked(kind: Callable[[str], float], least: float, most: float, rule: str) -> Callable[[str], float]:
    def check(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"{text!r} is not {rule}")
        return value

    return check


_port = _checked(int, 1, 65_535, "a port from 1 to 65535")
_count = _checked(int, 1, 10_000_000, "a whole number above 0")
_positive = _checked(float, 1e-3, 1e6, "a number from 0.001 to 1000000")
_rate = _checked(float, 5, 500, "a rate from 5 to 500 frames a second")
_share = _checked(float, 0, 1, "a share from 0 to 1")
