"""Reading the history of a device: messages, and values in as few points as a chart shows.

Values are kept at full rate, then as minutes, then as hours (`retention`). A query reads all three, so that
its answer does not depend on how far the summaries have come. Every function blocks on the database.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import orjson
from sqlalchemy import Engine, Integer, Select, cast, func, literal, select, union_all

from handover_devices.storage import tables

MAX_POINTS: Final = 5_000
EXPORT_PAGE: Final = 5_000


class Point(NamedTuple):
    """The values of one interval: its begin in microseconds, and how many values it has."""

    t_us: int
    n: int
    mean: float
    min: float
    max: float


def series_of(engine: Engine, device: str) -> dict[str, int]:
    """Return the numbers of the series of a device by name."""
    query = select(tables.series.c.name, tables.series.c.id).where(tables.series.c.device == device)
    with engine.connect() as connection:
        return {row.name: row.id for row in connection.execute(query.order_by(tables.series.c.name))}


def points(engine: Engine, series: int, begin_us: int, end_us: int, max_points: int = 500) -> list[Point]:
    """Return at most `max_points` intervals of a series in `[begin_us, end_us)`, without empty ones."""
    return intervals(engine, series, begin_us, end_us, max(-(-(end_us - begin_us) // max_points), 1))


def intervals(engine: Engine, series: int, begin_us: int, end_us: int, width_us: int) -> list[Point]:
    """Return the intervals of `width_us` of a series in `[begin_us, end_us)`, without empty ones."""
    values = _all_tiers(series, begin_us, end_us).subquery()
    # `//` truncates on both databases; times before `begin_us` are not selected, so nothing is negative.
    number = cast((values.c.t_us - begin_us) // width_us, Integer).label("number")
    query = (
        select(
            number,
            func.sum(values.c.n),
            func.sum(values.c.mean * values.c.n),
            func.min(values.c.min),
            func.max(values.c.max),
        )
        .group_by(number)
        .order_by(number)
    )
    with engine.connect() as connection:
        rows = connection.execute(query).all()
    return [
        Point(begin_us + int(row[0]) * width_us, int(row[1]), float(row[2]) / int(row[1]), row[3], row[4])
        for row in rows
    ]


def _all_tiers(series: int, begin_us: int, end_us: int) -> Any:
    value = tables.values
    raw = select(
        value.c.t_us,
        literal(1).label("n"),
        value.c.value.label("mean"),
        value.c.value.label("min"),
        value.c.value.label("max"),
    )
    parts: list[Select[Any]] = [_within(raw, value, series, begin_us, end_us)]
    for table in (tables.minutes, tables.hours):
        summary = select(table.c.t_us, table.c.n, table.c.mean, table.c.min, table.c.max)
        parts.append(_within(summary, table, series, begin_us, end_us))
    return union_all(*parts)


def _within(query: Select[Any], table: Any, series: int, begin_us: int, end_us: int) -> Select[Any]:
    return query.where((table.c.series == series) & (table.c.t_us >= begin_us) & (table.c.t_us < end_us))


def every_value(
    engine: Engine, series: Mapping[str, int], begin_us: int, end_us: int
) -> Iterator[tuple[str, Point]]:
    """Yield all stored values (or summaries) of series, each in the order of time, page by page."""
    for name, number in series.items():
        from_us = begin_us
        while True:
            values = _all_tiers(number, from_us, end_us).subquery()
            query = select(values).order_by(values.c.t_us).limit(EXPORT_PAGE)
            with engine.connect() as connection:
                rows = connection.execute(query).all()
            for row in rows:
                yield name, Point(*row)
            if len(rows) < EXPORT_PAGE:
                break
            from_us = rows[-1].t_us + 1


def samples(
    engine: Engine, series: int, begin_us: int, end_us: int, maximum: int
) -> list[tuple[float, float]]:
    """Return the first values of a series at full rate in `[begin_us, end_us)`, with seconds since 1970."""
    value = tables.values.c
    query = select(value.t_us, value.value).order_by(value.t_us).limit(maximum)
    within = _within(query, tables.values, series, begin_us, end_us)
    with engine.connect() as connection:
        return [(row.t_us / 1e6, row.value) for row in connection.execute(within)]


def latest(engine: Engine, device: str) -> dict[str, tuple[int, float]]:
    """Return the latest value of each series of a device, at full rate: time in microseconds, and value."""
    latest_of: dict[str, tuple[int, float]] = {}
    with engine.connect() as connection:
        for name, number in series_of(engine, device).items():
            query = (
                select(tables.values.c.t_us, tables.values.c.value)
                .where(tables.values.c.series == number)
                .order_by(tables.values.c.t_us.desc())
                .limit(1)
            )
            row = connection.execute(query).first()
            if row is not None:
                latest_of[name] = (row.t_us, row.value)
    return latest_of


def messages(
    engine: Engine,
    device: str,
    *,
    before: int | None = None,
    limit: int = 100,
    types: Sequence[str] = (),
    direction: str | None = None,
) -> list[dict[str, Any]]:
    """Return the newest messages of a device with a number below `before`, newest first."""
    table = tables.messages
    query = select(table).where(table.c.device == device).order_by(table.c.id.desc()).limit(limit)
    if before is not None:
        query = query.where(table.c.id < before)
    if types:
        query = query.where(table.c.type.in_(types))
    if direction is not None:
        query = query.where(table.c.direction == direction)
    with engine.connect() as connection:
        return [
            {
                "number": row.id,
                "at": row.at_us / 1e6,
                "direction": row.direction,
                "type": row.type,
                "message": _read(row.body),
                "answer": row.answer,
            }
            for row in connection.execute(query)
        ]


def _read(body: str) -> Any:
    try:
        return orjson.loads(body)
    except orjson.JSONDecodeError:  # a line that was refused
        return body
