"""The source `serial`: a glove on a serial port (USB or Bluetooth), which may be unplugged at any time."""

import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from glove_sdk_bridge.errors import BadLine, BridgeError, Dropped, Say
from glove_sdk_bridge.frames import Five, Frame
from glove_sdk_bridge.lines import Lines
from glove_sdk_bridge.serial_lines import MAX_SERIAL_LINE_BYTES, parse_serial_line

if TYPE_CHECKING:
    from serial import Serial

BAUD = 115_200
FULL_SCALE = 4095
"""The largest value of a 12-bit converter, which most gloves have."""

REOPEN_INTERVAL_S = 0.5
_READ_TIMEOUT_S = 0.5


class SerialGlove:
    """The glove on `port`, such as `/dev/ttyUSB0` or `COM3`.

    With `invert`, values are subtracted from `full_scale`: for sensors whose values fall when a finger is
    stretched, as with most OpenGloves firmware. Raises `BridgeError` if the port cannot be opened.
    """

    patience_s = 0.0

    def __init__(
        self,
        port: str,
        *,
        say: Say,
        baud: int = BAUD,
        invert: bool = False,
        full_scale: int = FULL_SCALE,
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self.dropped = Dropped(port, say)
        self._port = port
        self._baud = baud
        self._full_scale = full_scale if invert else None
        self._say = say
        self._clock = clock
        self._wait = wait
        self._device = self._open()

    def frames(self) -> Iterator[Frame]:
        """Yield a frame for each line; reopen the port after the glove was unplugged."""
        device = self._device
        self._say(f"reading {self._port}")
        while True:
            try:
                yield from self._read(device)
            except OSError:
                device.close()
                self._say(f"{self._port} is gone; plug the glove in again")
            device = self._reopen()
            self._say(f"{self._port} is back")

    def _read(self, device: "Serial") -> Iterator[Frame]:
        """Yield frames until the device is removed, which raises OSError (as all errors of pyserial)."""
        lines = Lines(MAX_SERIAL_LINE_BYTES)
        first = True
        while True:
            data = device.read(max(1, device.in_waiting))
            t_s = self._clock()
            too_long = lines.too_long
            for line in lines.feed(data):
                if line.strip() and not (first and self._is_torn(line)):
                    yield from self._frame(line, t_s)
                first = False
            for _ in range(lines.too_long - too_long):
                self.dropped.add(f"a line holds at most {MAX_SERIAL_LINE_BYTES} bytes", b"")

    @staticmethod
    def _is_torn(line: bytes) -> bool:
        """Return True if the first line began before the port was opened; it is not counted as an error."""
        try:
            parse_serial_line(line)
        except BadLine:
            return True
        return False

    def _frame(self, line: bytes, t_s: float) -> Iterator[Frame]:
        try:
            bend = parse_serial_line(line)
        except BadLine as bad:
            self.dropped.add(bad.rule, line)
            return
        yield Frame(t_s, bend if self._full_scale is None else _inverted(bend, self._full_scale))

    def _open(self) -> "Serial":
        try:
            from serial import Serial, SerialException  # noqa: PLC0415 - only a glove on a wire needs it
        except ModuleNotFoundError:
            raise BridgeError(
                "a serial glove needs pyserial; install it with: pip install pyserial"
            ) from None
        try:
            device = Serial(self._port, self._baud, timeout=_READ_TIMEOUT_S, exclusive=True)
        except (SerialException, ValueError) as error:
            raise BridgeError(f"{self._port} cannot be opened ({_reason(error)}); {_ports()}") from None
        device.reset_input_buffer()
        return device

    def _reopen(self) -> "Serial":
        while True:
            self._wait(REOPEN_INTERVAL_S)
            try:
                return self._open()
            except BridgeError:
                continue


def _inverted(bend: Five, full_scale: int) -> Five:
    thumb, index, middle, ring, little = (full_scale - value for value in bend)
    return thumb, index, middle, ring, little


def _reason(error: Exception) -> str:
    """Return the reason without the name of the port, as the operating system describes it."""
    if isinstance(error, OSError) and isinstance(error.errno, int):
        import os  # noqa: PLC0415

        return os.strerror(error.errno)
    return str(error)


def _ports() -> str:
    from serial.tools.list_ports import comports  # noqa: PLC0415 - only a glove on a wire needs it

    names = sorted(port.device for port in comports())
    return (
        f"the ports here are {', '.join(names)}"
        if names
        else "no serial port is found here; plug the glove in"
    )
