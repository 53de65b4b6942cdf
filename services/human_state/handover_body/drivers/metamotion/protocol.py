"""The MetaWear protocol of a MetaMotionS, as far as its accelerometer (BMI270, module 3) needs it.

Commands are `module register values…`. Data are `03 04 x y z` as int16, little endian, scaled by the range:
the unit on the wire is g, and here m/s².
"""

import struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover_body.drivers.base import PacketError

SERVICE: Final = "326a9000-85cb-9195-d9dd-464cfbbae75a"
COMMAND: Final = "326a9001-85cb-9195-d9dd-464cfbbae75a"
NOTIFY: Final = "326a9006-85cb-9195-d9dd-464cfbbae75a"
GRAVITY: Final = 9.80665
RATES_HZ: Final = {25: 6, 50: 7, 100: 8, 200: 9}
RANGES_G: Final = {2: 0, 4: 1, 8: 2, 16: 3}
_MODULE: Final = 3
_DATA: Final = 4
_PACKED: Final = 5
_NORMAL_FILTER: Final = 0xA0


def start_commands(rate_hz: int, range_g: int) -> list[bytes]:
    """Return the commands that configure, subscribe and start the accelerometer."""
    configure = bytes([_MODULE, 3, _NORMAL_FILTER | RATES_HZ[rate_hz], RANGES_G[range_g]])
    return [configure, bytes([_MODULE, _DATA, 1]), bytes([_MODULE, 2, 1, 0]), bytes([_MODULE, 1, 1])]


def parse(data: bytes, range_g: int) -> NDArray[np.float64] | None:
    """Return samples in m/s², shape (1 or 3, 3); None for other modules; raise `PacketError`."""
    if len(data) < 2:
        raise PacketError(f"a notification of {len(data)} bytes; it has a module and a register")
    if data[0] != _MODULE or data[1] & 0x7F not in {_DATA, _PACKED}:
        return None
    body = data[2:]
    wanted = 6 if data[1] & 0x7F == _DATA else 18
    if len(body) != wanted:
        raise PacketError(f"{len(body)} bytes of acceleration; there are {wanted}")
    raw = np.frombuffer(body, dtype="<i2").reshape(-1, 3)
    return raw * (GRAVITY * range_g / 32768)


def build(sample_mps2: NDArray[np.float64], range_g: int) -> bytes:
    """Return the notification of one sample: what a simulated sensor sends."""
    raw = np.clip(np.round(sample_mps2 * 32768 / (GRAVITY * range_g)), -32768, 32767)
    return struct.pack("<BBhhh", _MODULE, _DATA, *(int(coordinate) for coordinate in raw.ravel()))
