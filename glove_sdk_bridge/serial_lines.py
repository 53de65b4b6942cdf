"""Serial lines: what gloves on a serial port write, one hand a line.

Two encodings are read, told apart line by line: OpenGloves' letters (`A512B600C588D601E590F512…`, thumb
to little under A to E, whatever else the glove has under other letters) and five numbers with commas.
"""

import re

from glove_sdk_bridge.errors import BadLine
from glove_sdk_bridge.frames import Five, five
from glove_sdk_bridge.lines import five_numbers

LONGEST_LINE_BYTES = 512
_LETTERS = "ABCDE"
_TOKEN = re.compile(r"([A-Z])(\d{0,9})|\([A-Z]{1,8}\)\d{0,9}", re.ASCII)


def parse_serial_line(line: bytes) -> Five:
    """Return the five values of `line`, thumb first; raise `BadLine` if it has not exactly five."""
    try:
        text = line.decode("ascii").strip()
    except UnicodeDecodeError:
        raise BadLine("not a text") from None
    return _lettered(text) if text[:1] in {*_LETTERS, "("} else five_numbers(text)


def _lettered(text: str) -> Five:
    values: dict[str, int] = {}
    place = 0
    while place < len(text):
        token = _TOKEN.match(text, place)
        if token is None:
            raise BadLine("letters with numbers are needed, A for the thumb to E for the little finger")
        letter, digits = token.group(1), token.group(2)
        if letter is not None and letter in _LETTERS:
            if letter in values or not digits:
                raise BadLine("A to E must come once each, with a number")
            values[letter] = int(digits)
        place = token.end()
    if len(values) != len(_LETTERS):
        raise BadLine("A to E must come once each, with a number")
    return five([values[letter] for letter in _LETTERS], "bend")
