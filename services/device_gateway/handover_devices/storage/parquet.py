"""The history of a device as a Parquet file (extra `parquet`, pyarrow).

The file is written to a temporary file, row group by row group: the memory in use does not depend on how much
history there is. Columns: `time` (timestamp, microseconds, UTC), `name` (dictionary), `value`, `count`,
`minimum`, `maximum`, as in the CSV.
"""

from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Final

from sqlalchemy import Engine

from handover.errors import Problem
from handover_devices.storage import history

GROUP_ROWS: Final = 50_000
CHUNK_BYTES: Final = 1 << 20


def write_parquet(engine: Engine, series: Mapping[str, int], begin_us: int, end_us: int) -> Path:
    """Write every stored value of series into a new temporary file, which the caller deletes.

    Blocks on the database. Raises `Problem` 501 without pyarrow.
    """
    try:
        import pyarrow as pa  # noqa: PLC0415 - an extra
        import pyarrow.parquet as pq  # noqa: PLC0415
    except ImportError:
        raise Problem.translated(
            501,
            "No Parquet",
            "device.no_parquet",
            "Parquet needs pyarrow, which is not installed; install the extra parquet where "
            "the device gateway runs, or take the CSV",
        ) from None
    schema = pa.schema(
        [
            pa.field("time", pa.timestamp("us", tz="UTC"), nullable=False),
            pa.field("name", pa.dictionary(pa.int32(), pa.string()), nullable=False),
            pa.field("value", pa.float64(), nullable=False),
            pa.field("count", pa.int64(), nullable=False),
            pa.field("minimum", pa.float64(), nullable=False),
            pa.field("maximum", pa.float64(), nullable=False),
        ]
    )
    rows = history.every_value(engine, series, begin_us, end_us)
    with NamedTemporaryFile(prefix="handover-", suffix=".parquet", delete=False) as file:
        path = Path(file.name)
    try:
        with pq.ParquetWriter(path, schema, compression="zstd") as writer:
            while page := list(islice(rows, GROUP_ROWS)):
                names, points = zip(*page, strict=True)
                columns = zip(*points, strict=True)
                times, counts, means, least, greatest = (list(column) for column in columns)
                columns_in_order = [times, list(names), means, counts, least, greatest]
                arrays = [
                    pa.array(values, type=field.type)
                    for values, field in zip(columns_in_order, schema, strict=True)
                ]
                writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    return path


def read_and_delete(path: Path) -> Iterator[bytes]:
    """Yield the content of a temporary file, and delete it at the end."""
    try:
        with path.open("rb") as file:
            while chunk := file.read(CHUNK_BYTES):
                yield chunk
    finally:
        path.unlink(missing_ok=True)
