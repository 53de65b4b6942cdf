"""The lines of gloves on a serial port.

Two encodings are supported in each line: the OpenGloves protocol (`A512B600C588D601E590F512…`, thumb to
little finger as A to E, other values ignored) and five numbers separated by commas.
"""

import re

from glove_sdk_bridge.errors import BadLine
from glove_sdk_bridge.frames import Five, five
from glove_sdk_bridge.lines import five_numbers

MAX_SERIAL_LINE_BYTES = 512
_FINGER_KEYS = "ABCDE"
_TOKEN = re.compile(r"([A-Z])(\d{0,9})|\([A-Z]{1,8}\)\d{0,9}", re.ASCII)


def parse_serial_line(line: bytes) -> Five:
    """Return the five values of `line`, thumb first; raises `BadLine`."""
    try:
        text = line.decode("ascii").strip()
    except UnicodeDecodeError:
        raise BadLine("not a text") from None
    return _parse_opengloves(text) if text[:1] in {*_FINGER_KEYS, "("} else five_numbers(text)


def _parse_opengloves(text: str) -> Five:
    values: dict[str, int] = {}
    place = 0
    while place < len(text):
        token = _TOKEN.match(text, place)
        if token is None:
            raise BadLine("letters with numbers are needed, A for the thumb to E for the little finger")
        key, digits = token.group(1), token.group(2)
        if key is not None and key in _FINGER_KEYS:
            if key in values or not digits:
                raise BadLine("A to E must come once each, with a number")
            values[key] = int(digits)
        place = token.end()
    if len(values) != len(_FINGER_KEYS):
        raise BadLine("A to E must come once each, with a number")
    return five([values[key] for key in _FINGER_KEYS], "bend")
