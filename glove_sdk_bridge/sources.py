"""Glove sources by name: each is a command of the glove bridge, ours and those of other installed packages.

A package registers an object like those below, and its name becomes a command:

    [project.entry-points."handover.glove_sources"]
    udp = "udp_glove:SOURCE"
"""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from glove_sdk_bridge.arguments import add_controller, count, poses, positive, rate, share
from glove_sdk_bridge.controller_client import ControllerClient
from glove_sdk_bridge.errors import BridgeError, Say
from glove_sdk_bridge.forward import Forward
from glove_sdk_bridge.replay import RATE_HZ, Replay
from glove_sdk_bridge.serial_port import BAUD, FULL_SCALE, SerialGlove
from glove_sdk_bridge.simulation.glove import SimulatedGlove
from glove_sdk_bridge.simulation.glove_operator import SimulatedOperator
from glove_sdk_bridge.simulation.hand import RATE_HZ as HAND_RATE_HZ
from glove_sdk_bridge.simulation.hand import SimulatedHand
from glove_sdk_bridge.simulation.screen import Screen
from glove_sdk_bridge.source import Source

GROUP = "handover.glove_sources"


@dataclass(frozen=True, slots=True)
class SourceKind:
    """One kind of source: its line of help, its arguments, and how a `Source` is made from them.

    The arguments `--glove`, `--hand`, `--host`, `--port` and `--token` are there already.
    """

    summary: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    make: Callable[[argparse.Namespace, Say], Source]


def source_kinds() -> Mapping[str, SourceKind]:
    """Return all kinds by name, ours first; one that cannot be loaded says so when it is used."""
    kinds = dict(OWN)
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        if point.name not in kinds:
            kinds[point.name] = _loaded(point)
    return kinds


def _loaded(point: EntryPoint) -> SourceKind:
    try:
        kind = point.load()
    except Exception as error:  # noqa: BLE001 - a package of somebody else may fail in any way
        return _unusable(f"{point.value} cannot be loaded: {type(error).__name__}: {error}")
    if not isinstance(kind, SourceKind):
        return _unusable(f"{point.value} is no glove_sdk_bridge.sources.SourceKind")
    return kind


def _unusable(reason: str) -> SourceKind:
    def make(_: argparse.Namespace, __: Say) -> Source:
        raise BridgeError(f"{reason}; repair or remove the package that registers it")

    def any_arguments(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("arguments", nargs=argparse.REMAINDER)

    return SourceKind(reason.replace("%", "%%"), any_arguments, make)


def _forward(_: argparse.Namespace, say: Say) -> Source:
    return Forward(say=say)


def _replay_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, help="recording (.jsonl) or table (.csv)")
    parser.add_argument("--pose", type=poses, default=(), metavar="N[,N]", help="only these poses of a table")
    parser.add_argument(
        "--rate", type=positive, default=RATE_HZ, help="frames a second of a table (default: %(default)g)"
    )
    parser.add_argument(
        "--speed", type=positive, default=1.0, help="times as fast as recorded; frames keep their own time"
    )
    parser.add_argument("--loop", action="store_true", help="again and again")


def _replay(options: argparse.Namespace, say: Say) -> Source:
    return Replay(
        options.file,
        say=say,
        poses=options.pose,
        rate_hz=options.rate,
        speed=options.speed,
        loop=options.loop,
    )


def _serial_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("device", help="serial port, such as /dev/ttyUSB0 or COM3")
    parser.add_argument("--baud", type=count, default=BAUD, help="bits a second (default: %(default)s)")
    parser.add_argument(
        "--invert", action="store_true", help="the values fall when a finger is stretched (most OpenGloves)"
    )
    parser.add_argument(
        "--full-scale",
        type=count,
        default=FULL_SCALE,
        metavar="N",
        help="with --invert: the largest value (default: %(default)s)",
    )


def _serial(options: argparse.Namespace, say: Say) -> Source:
    return SerialGlove(
        options.device, say=say, baud=options.baud, invert=options.invert, full_scale=options.full_scale
    )


def _simulate_arguments(parser: argparse.ArgumentParser) -> None:
    add_controller(parser)
    parser.add_argument(
        "--rate", type=rate, default=HAND_RATE_HZ, help="frames a second (default: %(default)g)"
    )
    parser.add_argument("--seed", type=int, help="the same seed moves the hand in the same way")
    parser.add_argument(
        "--mistakes", type=share, default=0.15, help="share of attempts that go wrong (default: %(default)g)"
    )
    parser.add_argument("--speed", type=positive, default=1.0, help="times as quick as a person")
    parser.add_argument(
        "--no-calibrate", dest="calibrate", action="store_false", help="use the thresholds that are there"
    )


def _simulate(options: argparse.Namespace, say: Say) -> Source:
    return SimulatedGlove(
        SimulatedHand(options.seed, rate_hz=options.rate),
        SimulatedOperator(options.seed, options.mistakes, options.speed),
        Screen(ControllerClient(options.controller), options.glove, say=say),
        say=say,
        calibrate=options.calibrate,
    )


OWN: Mapping[str, SourceKind] = {
    "forward": SourceKind(
        'Frames on standard input, one a line: five numbers with commas, {"bend":[…]} or a whole frame.',
        lambda _: None,
        _forward,
    ),
    "replay": SourceKind(
        "Play a recording (JSON lines) or a table of poses (CSV).", _replay_arguments, _replay
    ),
    "serial": SourceKind(
        "Read a glove on a serial port: OpenGloves or five numbers.", _serial_arguments, _serial
    ),
    "simulate": SourceKind(
        "A simulated operator does what the Tasks ask for.", _simulate_arguments, _simulate
    ),
}
