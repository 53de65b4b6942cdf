"""A glove source that receives frames as UDP datagrams."""

import argparse
import socket
import time
from collections.abc import Iterator

from glove_sdk_bridge.errors import BadLine, Dropped, Say
from glove_sdk_bridge.forward import parse_forwarded
from glove_sdk_bridge.frames import Frame
from glove_sdk_bridge.sources import SourceKind

MAX_DATAGRAM_BYTES = 4096


class UdpGlove:
    """Frames as they arrive on a UDP port of this machine."""

    patience_s = None

    def __init__(self, host: str, port: int, say: Say) -> None:
        self.dropped = Dropped(f"UDP port {port}", say)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((host, port))
        say(f"frames are received on UDP {host}:{port}")

    def frames(self) -> Iterator[Frame]:
        """Yield one frame for each datagram."""
        while True:
            datagram = self._socket.recv(MAX_DATAGRAM_BYTES)
            try:
                frame = parse_forwarded(datagram, time.monotonic())
            except BadLine as error:
                self.dropped.add(error.rule, datagram)
                continue
            if frame is not None:
                yield frame


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `handover glove udp`."""
    parser.add_argument("--listen", type=int, default=9999, metavar="PORT", help="UDP port (%(default)s)")
    parser.add_argument("--listen-host", default="127.0.0.1", help="its address (%(default)s)")


def make(arguments: argparse.Namespace, say: Say) -> UdpGlove:
    """Return the source for these arguments."""
    return UdpGlove(arguments.listen_host, arguments.listen, say)


SOURCE = SourceKind("Frames in UDP datagrams, in a format of forward.", add_arguments, make)
