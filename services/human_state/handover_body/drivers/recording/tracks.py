"""The signals of a recording, read from files of five formats.

A file is read whole (in a thread, at most `MAX_BYTES`), and checked: lengths, rates, times that increase,
units that are known. What cannot be read is a `RecordingError` that names the file and the way out.
"""

import csv
import gzip
import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from handover.distribution import install_command
from handover.messages import message, text_of
from handover_body.drivers.recording.channels import (
    LeftOut,
    Meaning,
    RecordingError,
    UnknownUnit,
    kind_of,
    plausible_rates_hz,
    time_unit_s,
    unit_of,
)
from handover_body.formats.json_messages import from_json
from handover_body.model.signals import Samples, SignalInfo

SAMPLES_SCHEMA: Final = "handover.Samples"
MAX_BYTES: Final = 512 * 1024 * 1024
MAX_TRACKS: Final = 128
MIN_IN_STEP: Final = 0.9
"""A signal whose samples mostly follow at one rate has that rate, and gaps."""
MAX_CSV_ROWS: Final = 20_000_000
MAX_TEXT_CHARS: Final = 1000

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One signal of a recording: `values` (samples, channels), from `start_s` after the beginning.

    Irregular signals have `times_s` after the beginning, which increase; so have regular ones with gaps.
    """

    name: str
    info: SignalInfo
    values: Floats
    start_s: float = 0.0
    times_s: Floats | None = None

    @property
    def end_s(self) -> float:
        """Return the time after the last sample."""
        if self.times_s is not None:
            return float(self.times_s[-1]) if len(self.times_s) else 0.0
        return self.start_s + len(self.values) / (self.info.rate_hz or 1.0)

    def runs(self, first: int, end: int) -> list[tuple[int, int]]:
        """Return the parts of the samples `first` to `end` without a gap in them."""
        if self.times_s is None or self.info.rate_hz is None:
            return [(first, end)]
        apart = np.diff(self.times_s[first:end]) * self.info.rate_hz
        cuts = [first, *(first + 1 + np.flatnonzero(np.abs(apart - 1) >= 0.5)), end]
        return [(int(begin), int(two)) for begin, two in pairwise(cuts)]


@dataclass(frozen=True, slots=True)
class Recording:
    """All signals of a recording. `began_s` is when it was made, in s since 1970, if the file says so."""

    tracks: tuple[Track, ...]
    began_s: float | None = None
    left_out: tuple[LeftOut, ...] = ()

    @property
    def duration_s(self) -> float:
        """Return the time of the last sample after the beginning."""
        return max(track.end_s for track in self.tracks)


def read(path: Path, meanings: dict[str, Meaning]) -> Recording:
    """Return the recording in `path`. `meanings` are by channel; those that nothing explains are left out."""
    suffix = path.suffix.lower()
    if suffix == ".gz":
        suffix = Path(path.stem).suffix.lower() + suffix
    reader = _READERS.get(suffix)
    if reader is None:
        kinds = ", ".join(sorted(_READERS))
        raise RecordingError(f"{path.name} is no recording that can be read; it must end with one of {kinds}")
    if not path.is_file():
        raise RecordingError(f"there is no recording {path}; give the path of a file that exists")
    if (size := path.stat().st_size) > MAX_BYTES:
        raise RecordingError(f"{path.name} has {size:,} bytes; at most {MAX_BYTES:,} are read, so cut it")
    try:
        recording = reader(path, meanings)
    except RecordingError:
        raise
    except ImportError as error:
        raise RecordingError(
            f"{path.name} needs {error.name}; install the extra: {install_command('body')}"
        ) from error
    except Exception as error:  # the libraries raise anything for a damaged file
        raise RecordingError(
            f"{path.name} cannot be read: {type(error).__name__}: {error}; is the file complete?"
        ) from error
    if not recording.tracks:
        why = "; ".join(f"{omitted.name}: {omitted.reason}" for omitted in recording.left_out)
        raise RecordingError(
            f"{path.name} has no channel whose kind is known; name some in `channels` of the driver, or with "
            f"--channel NAME=KIND[UNIT]{f' ({why})' if why else ''}"[:MAX_TEXT_CHARS]
        )
    for track in recording.tracks:
        _check(track, path)
    return recording


def _check(track: Track, path: Path) -> None:
    times_s = track.times_s
    if len(track.values) == 0:
        raise RecordingError(f'"{track.name}" in {path.name} has no samples; leave it out of `channels`')
    if not math.isfinite(track.start_s) or (times_s is not None and not np.all(np.isfinite(times_s))):
        raise RecordingError(f'"{track.name}" in {path.name} has times that are no numbers; repair the file')
    if times_s is not None and np.any(np.diff(times_s) < 0):
        raise RecordingError(f'the times of "{track.name}" in {path.name} run backwards; sort the file')


def _track(
    name: str, values: Floats, rate_hz: float | None, unit: str, meanings: dict[str, Meaning], **times: Any
) -> Track | LeftOut:
    meaning = meanings.get(name)
    kind = meaning.kind if meaning else kind_of(name)
    if meanings and meaning is None:
        return LeftOut(name, message("health.channel.not_named", "it is not among the named channels"))
    if kind is None:
        return LeftOut(
            name,
            message(
                "health.channel.kind_unclear", "its kind is not clear from its name; name it with its kind"
            ),
        )
    try:
        code, factor = unit_of(meaning.unit if meaning and meaning.unit else unit, name, kind)
    except UnknownUnit as unknown:
        if meaning:
            raise
        return LeftOut(name, text_of(unknown))
    columns = values.reshape(len(values), -1) * factor
    channels = (name,) if columns.shape[1] == 1 else tuple(str(number) for number in range(columns.shape[1]))
    try:
        info = SignalInfo(kind, code, rate_hz, channels, method=f"recorded, {name}")
    except ValueError as error:
        if meaning:
            raise RecordingError(f'"{name}": {error}') from None
        return LeftOut(name, str(error))
    return Track(name, info, columns, **times)


def _recording(contents: Iterable[Track | LeftOut], began_s: float | None = None) -> Recording:
    parts = list(contents)
    tracks = tuple(part for part in parts if isinstance(part, Track))
    if len(tracks) > MAX_TRACKS:
        raise RecordingError(f"{len(tracks)} signals are too many; name at most {MAX_TRACKS} in `channels`")
    return Recording(tracks, began_s, tuple(part for part in parts if isinstance(part, LeftOut)))


def _wfdb(path: Path, meanings: dict[str, Meaning]) -> Recording:
    import wfdb  # type: ignore[import-untyped]  # noqa: PLC0415 - of the extra

    # Frames are not smoothed: that averages the samples of a fast signal to the rate of the frames.
    record = wfdb.rdrecord(str(path.with_suffix("")), smooth_frames=False)
    if record.e_p_signal is None or not record.fs:
        raise RecordingError(f"{path.name} has no signals with a rate; give the header of a signal record")
    began_s = record.base_datetime.timestamp() if record.base_datetime else None
    rates_hz = [float(record.fs) * count for count in record.samps_per_frame]
    return _recording(
        (
            _track(name, values, rate_hz, unit or "", meanings)
            for name, values, rate_hz, unit in zip(
                record.sig_name, record.e_p_signal, rates_hz, record.units, strict=True
            )
        ),
        began_s,
    )


def _edf(path: Path, meanings: dict[str, Meaning]) -> Recording:
    import pyedflib  # noqa: PLC0415 - of the extra

    with pyedflib.EdfReader(str(path)) as edf:
        tracks = [
            _track(
                edf.getLabel(at).strip(),
                edf.readSignal(at),
                float(edf.getSampleFrequency(at)),
                edf.getPhysicalDimension(at),
                meanings,
            )
            for at in range(edf.signals_in_file)
        ]
        return _recording(tracks, edf.getStartdatetime().timestamp())


def _xdf(path: Path, meanings: dict[str, Meaning]) -> Recording:
    import pyxdf  # type: ignore[import-untyped]  # noqa: PLC0415 - of the extra

    with path.open("rb") as file:
        streams, _ = pyxdf.load_xdf(file, verbose=False)
    filled = [stream for stream in streams if len(stream["time_stamps"])]
    origin_s = min((float(stream["time_stamps"][0]) for stream in filled), default=0.0)
    return _recording(_xdf_track(stream, origin_s, meanings) for stream in filled)


def _xdf_track(stream: dict[str, Any], origin_s: float, meanings: dict[str, Meaning]) -> Track | LeftOut:
    info, times_s = stream["info"], np.asarray(stream["time_stamps"], dtype=np.float64) - origin_s
    name = str(info["name"][0])
    if info["channel_format"][0] == "string":
        return LeftOut(name, "it has markers, no signal")
    kind = kind_of(name) or kind_of(str(info["type"][0]))
    if not meanings and kind is not None:
        meanings = {name: Meaning(kind)}
    desc = info.get("desc") or [None]
    channels = ((desc[0] or {}).get("channels") or [{}])[0] or {}
    units = [channel.get("unit", [""])[0] for channel in channels.get("channel", [])] if channels else []
    values = np.asarray(stream["time_series"], dtype=np.float64)
    nominal = float(info["nominal_srate"][0])
    unit = str(units[0]) if units else ""
    # Gaps are kept: the times of a stream are those that were recorded, not only its rate.
    share = _share_in_step(times_s, nominal) if nominal > 0 else 0.0
    if share == 1.0:
        return _track(name, values, nominal, unit, meanings, start_s=float(times_s[0]))
    return _track(name, values, nominal if share >= MIN_IN_STEP else None, unit, meanings, times_s=times_s)


def _mcap(path: Path, meanings: dict[str, Meaning]) -> Recording:
    """Read the samples of a recording of ours; features, reports and other messages are left out."""
    from mcap.reader import make_reader  # noqa: PLC0415 - of the extra

    chunks: dict[str, list[Samples]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            if channel.message_encoding != "json" or schema is None or schema.name != SAMPLES_SCHEMA:
                continue
            samples = from_json(schema.name, json.loads(message.data))
            if isinstance(samples, Samples) and len(samples.values):
                chunks.setdefault(channel.topic, []).append(samples)
    origin_s = min((parts[0].start_s for parts in chunks.values()), default=0.0)
    tracks = [_mcap_track(topic, parts, origin_s, meanings) for topic, parts in chunks.items()]
    return _recording(tracks, origin_s or None)


def _mcap_track(
    topic: str, parts: Sequence[Samples], origin_s: float, meanings: dict[str, Meaning]
) -> Track | LeftOut:
    info = parts[0].info
    if meanings and topic not in meanings:
        return LeftOut(topic, "it is not among the named channels")
    alike = [part for part in parts if len(part.info.channels) == len(info.channels)]
    values = np.concatenate([part.values for part in alike])
    times_s = np.concatenate([part.sample_times_s() for part in alike]) - origin_s
    if info.rate_hz and _share_in_step(times_s, info.rate_hz) == 1.0:
        return Track(topic, info, values, start_s=float(times_s[0]))
    has_rate = bool(info.rate_hz) and _share_in_step(times_s, info.rate_hz or 1.0) >= MIN_IN_STEP
    return Track(topic, info if has_rate else replace(info, rate_hz=None), values, times_s=times_s)


def _share_in_step(times_s: Floats, rate_hz: float) -> float:
    """Return the share of samples that follow the one before after one period."""
    return float(np.mean(np.abs(np.diff(times_s) * rate_hz - 1) < 0.5)) if len(times_s) > 1 else 1.0


def _csv(path: Path, meanings: dict[str, Meaning]) -> Recording:
    """Read a table with a header `time [s],ecg [mV],…`; the unit of times may be another one.

    Times without a unit are in s where all channels have a plausible rate then; else their unit is asked for.
    """
    opener = gzip.open if path.suffix == ".gz" else open
    with opener(path, "rt", newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file)
        header = next(rows, None)
        time_s = time_unit_s(header[0] if header else "", path.name)
        assert header is not None  # noqa: S101 - refused above
        table: list[list[float]] = []
        for number, row in enumerate(rows, start=2):
            if not row:
                continue
            if len(row) != len(header):
                raise RecordingError(f"line {number} of {path.name} has {len(row)} of {len(header)} values")
            try:
                table.append([float(cell) if cell.strip() else math.nan for cell in row])
            except ValueError:
                raise RecordingError(f"line {number} of {path.name} has a cell that is no number") from None
            if len(table) > MAX_CSV_ROWS:
                raise RecordingError(f"{path.name} has more than {MAX_CSV_ROWS:,} lines; cut it")
    if len(table) < 2:
        raise RecordingError(f"{path.name} has fewer than two lines of values; there is nothing to replay")
    array = np.array(table)
    times_s = array[:, 0] * (time_s or 1.0)
    began_s, times_s = float(times_s[0]), times_s - times_s[0]
    period_s = float(np.median(np.diff(times_s)))
    share = _share_in_step(times_s, 1 / period_s) if period_s > 0 else 0.0
    rate_hz = None
    if share == 1.0:
        rate_hz = (len(times_s) - 1) / float(times_s[-1])
    elif share >= MIN_IN_STEP:  # with gaps
        rate_hz = 1 / float(np.mean(np.diff(times_s)[np.abs(np.diff(times_s) / period_s - 1) < 0.5]))
    names = [_named(cell) for cell in header[1:]]
    placed = {} if share == 1.0 else {"times_s": times_s}
    recording = _recording(
        (
            _track(name, array[:, at], rate_hz, unit, meanings, **placed)
            for at, (name, unit) in enumerate(names, start=1)
        ),
        began_s if began_s > 1e8 else None,
    )
    if time_s is None and period_s > 0 and not np.any(np.diff(times_s) < 0):
        _require_seconds(path, 1 / period_s, recording.tracks)
    return recording


def _require_seconds(path: Path, rate_hz: float, tracks: Iterable[Track]) -> None:
    """Raise `RecordingError` for times without a unit that give a channel an implausible rate as s."""
    for track in tracks:
        least_hz, most_hz = plausible_rates_hz(track.info.kind)
        if not least_hz * (1 - 1e-6) <= rate_hz <= most_hz * (1 + 1e-6):
            raise RecordingError(
                f'the times of {path.name} have no unit; in s, "{track.name}" would have {rate_hz:.4g} Hz; '
                f"{least_hz:.2g} to {most_hz:g} Hz are plausible for the kind {track.info.kind}; write the "
                "unit in the header: `time [s]` or `time [ms]`"
            )


def _named(cell: str) -> tuple[str, str]:
    name, bracket, rest = cell.partition("[")
    return name.strip(), rest.rstrip("] ") if bracket else ""


_READERS: Final[dict[str, Callable[[Path, dict[str, Meaning]], Recording]]] = {
    ".hea": _wfdb,
    ".edf": _edf,
    ".bdf": _edf,
    ".xdf": _xdf,
    ".mcap": _mcap,
    ".csv": _csv,
    ".csv.gz": _csv,
}
