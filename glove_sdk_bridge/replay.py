"""The source `replay`: plays recorded frames at their original pace.

Two kinds of files are supported: recordings (JSON lines), and tables (CSV) with the columns pose, thumb,
index, middle, ring and little, which have no time and are played at a given rate.
"""

import csv
import itertools
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from pathlib import Path

from glove_sdk_bridge.errors import BadLine, BridgeError, Dropped, Say
from glove_sdk_bridge.frames import FINGERS, Frame, five
from glove_sdk_bridge.lines import number
from glove_sdk_bridge.recording import hello_of, is_recording, read_recording

RATE_HZ = 50.0
MAX_GAP_S = 2.0
"""Longer gaps in a recording are shortened to this."""


class Replay:
    """The frames of the file at `path`, `speed` times as fast as recorded, repeated forever with `loop`.

    The time stamps keep the spacing of the recording at any speed. A table is played at `rate_hz`, only the
    `poses` if any are given. Raises `BridgeError` if the file cannot be played.
    """

    patience_s = None

    def __init__(
        self,
        path: Path,
        *,
        say: Say,
        poses: Collection[str] = (),
        rate_hz: float = RATE_HZ,
        speed: float = 1.0,
        loop: bool = False,
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self.dropped = Dropped(str(path), say)
        self._path = path
        self._rate_hz = rate_hz
        self._poses = frozenset(poses)
        self._speed = speed
        self._loop = loop
        self._clock = clock
        self._wait = wait
        try:
            self._is_recording = is_recording(path)
            self.hand = (hello.hand if (hello := hello_of(path)) else None) if self._is_recording else None
            """The hand of the recording, if the file has it."""
        except OSError as error:
            raise BridgeError(f"{path} cannot be read ({error.strerror}); check its name") from None
        if self._is_recording and poses:
            raise BridgeError(f"{path} is a recording, which has no poses; leave --pose out")
        if next(self._recorded(), None) is None:
            raise BridgeError(self._nothing_to_play())

    def frames(self) -> Iterator[Frame]:
        """Yield each frame at its time, with time stamps that begin now."""
        began_s = self._clock()
        for frame in self._with_relative_times():
            due_s = began_s + frame.t_s / self._speed
            if (early_s := due_s - self._clock()) > 0:
                self._wait(early_s)
            yield replace(frame, t_s=began_s + frame.t_s)

    def _with_relative_times(self) -> Iterator[Frame]:
        """Yield the frames with times relative to the first one; endless with `loop`."""
        at_s, last_s, step_s = 0.0, 0.0, 0.0
        for lap in itertools.count():
            for place, frame in enumerate(self._recorded()):
                if place:
                    step_s = min(max(frame.t_s - last_s, 0.0), MAX_GAP_S)
                last_s = frame.t_s
                if place or lap:
                    at_s += step_s or 1 / self._rate_hz
                yield replace(frame, t_s=at_s)
            if not self._loop:
                return

    def _recorded(self) -> Iterator[Frame]:
        if self._is_recording:
            return read_recording(self._path, self.dropped)
        return (
            Frame(place / self._rate_hz, frame.bend)
            for place, (pose, frame) in enumerate(read_table(self._path, self.dropped, self._poses))
        )

    def _nothing_to_play(self) -> str:
        if not self._poses:
            return f"{self._path} holds no frames; nothing can be played"
        there = sorted({pose for pose, _ in read_table(self._path, self.dropped)})
        wanted = ", ".join(sorted(self._poses))
        return f"{self._path} has no frames of pose {wanted}; its poses are {', '.join(there) or 'none'}"


def read_table(
    path: Path, dropped: Dropped, poses: Collection[str] = frozenset()
) -> Iterator[tuple[str, Frame]]:
    """Yield pose and frame of each row of the table at `path`, only of `poses` if any are given.

    Invalid rows are dropped and counted; a table without the columns raises `BridgeError`.
    """
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        rows = csv.reader((line.replace("\0", "") for line in file), strict=False)
        places = _columns(path, next(_without_errors(rows, dropped), []))
        for row in _without_errors(rows, dropped):
            if not any(cell.strip() for cell in row):
                continue
            try:
                pose, frame = _row(row, places)
            except BadLine as bad:
                dropped.add(bad.rule, ",".join(row))
                continue
            if not poses or pose in poses:
                yield pose, frame


def _columns(path: Path, header: list[str]) -> dict[str, int]:
    names = [name.strip().lower() for name in header]
    missing = [finger for finger in FINGERS if finger not in names]
    if missing:
        raise BridgeError(
            f"{path} has no column {', '.join(missing)}; its first line must name "
            f"pose, {', '.join(FINGERS)}, or it must be a recording of ours"
        )
    return {name: names.index(name) for name in ("pose", *FINGERS) if name in names}


def _row(row: list[str], places: dict[str, int]) -> tuple[str, Frame]:
    if len(row) <= max(places.values()):
        raise BadLine("a row needs a value in every column")
    pose = row[places["pose"]].strip() if "pose" in places else ""
    return pose, Frame(0.0, five([number(row[places[finger]].strip()) for finger in FINGERS], "bend"))


def _without_errors(rows: "Iterator[list[str]]", dropped: Dropped) -> Iterator[list[str]]:
    """Yield rows; a row that the csv module rejects, such as one with a huge cell, is dropped and counted."""
    while True:
        try:
            yield next(rows)
        except StopIteration:
            return
        except csv.Error as error:
            dropped.add(str(error), "")
