"""REST of the history: messages, values over time, CSV; and telemetry by HTTP for small devices."""

import asyncio
import csv
import io
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from itertools import islice
from typing import Annotated, Any, Final, Literal

import numpy as np
from fastapi import Depends, FastAPI, Header, Query, Request, Response
from sqlalchemy import Engine
from starlette.responses import StreamingResponse

from handover.errors import Problem
from handover.formats.validation import MAX_INTEGER
from handover.http.api_description import TaggedRoutes, sends
from handover.http.body_limit import max_body
from handover.security.guard import OtherCredential, in_path, require
from handover.security.permissions import Permission
from handover_datamodels.times import iso
from handover_devices.forecast import COVERAGE, MAX_ORIGINS, TooShort, forecast, needed_intervals
from handover_devices.gateway import DeviceGateway
from handover_devices.protocol.messages import MAX_LINE_BYTES
from handover_devices.routes.views import ForecastView, MessageView, SeriesView
from handover_devices.storage import history
from handover_devices.storage.parquet import read_and_delete, write_parquet

OF_DEVICE = in_path("Device", "device")
INGEST: Final = "/ingest/{device}"
DAY_S: Final = 86_400.0
HOUR_US: Final = 3.6e9
MIN_SEASON_STEPS: Final = 4
MAX_TIME_S: Final = 1e11
ROWS_AT_ONCE: Final = 2_000

Time = Annotated[float | None, Query(ge=0, le=MAX_TIME_S, description="seconds since 1970")]


def add_history_routes(app: FastAPI, gateway: DeviceGateway, engine: Engine) -> None:
    """Add the routes of the history."""
    routes = TaggedRoutes(app, "history")
    may_read = require(Permission.READ, OF_DEVICE)

    @routes.get("/devices/{device}/messages", dependencies=[may_read])
    async def messages(
        device: str,
        before: Annotated[
            int | None, Query(ge=0, le=MAX_INTEGER, description="number of the last message seen")
        ] = None,
        limit: Annotated[int, Query(ge=1, le=1000)] = 100,
        type: Annotated[list[str] | None, Query()] = None,  # noqa: A002 - the name of the parameter
        direction: Annotated[Literal["in", "out"] | None, Query(description="in: from the device")] = None,
    ) -> list[MessageView]:
        """List messages that the device sent and received, newest first."""
        gateway.device(device)
        rows = await asyncio.to_thread(
            lambda: history.messages(
                engine, device, before=before, limit=limit, types=type or (), direction=direction
            )
        )
        return [MessageView(**row) for row in rows]  # type: ignore[typeddict-item]

    @routes.get("/devices/{device}/values", dependencies=[may_read])
    async def values(
        device: str,
        name: Annotated[list[str] | None, Query(description="names of values; all without it")] = None,
        begin: Time = None,
        end: Time = None,
        points: Annotated[int, Query(ge=1, le=history.MAX_POINTS)] = 500,
    ) -> list[SeriesView]:
        """Return values over time in at most so many intervals, each with mean, minimum and maximum.

        Without times, those of the last 24 hours.
        """
        all_series = gateway.device(device).values
        series = await _series(device, name)
        begin_us, end_us = _interval(begin, end)

        def read() -> list[SeriesView]:
            return [
                {
                    "name": value_name,
                    "unit": all_series[value_name].unit if value_name in all_series else None,
                    "points": [
                        {"t": p.t_us / 1e6, "n": p.n, "mean": p.mean, "min": p.min, "max": p.max}
                        for p in history.points(engine, number, begin_us, end_us, points)
                    ],
                }
                for value_name, number in series.items()
            ]

        return await asyncio.to_thread(read)

    @routes.get(
        "/devices/{device}/values.csv",
        response_class=Response,
        responses=sends("text/csv"),
        dependencies=[may_read],
    )
    async def values_csv(
        device: str,
        name: Annotated[list[str] | None, Query()] = None,
        begin: Time = None,
        end: Time = None,
    ) -> Response:
        """Return every stored value as CSV: time, name, mean, count, minimum, maximum."""
        series = await _series(device, name)
        rows = _csv(engine, series, *_interval(begin, end))
        headers = {"Content-Disposition": f'attachment; filename="{device}.csv"'}
        # Starlette iterates over it in a thread.
        return StreamingResponse(rows, media_type="text/csv; charset=utf-8", headers=headers)

    @routes.get(
        "/devices/{device}/values.parquet",
        response_class=Response,
        responses=sends("application/vnd.apache.parquet"),
        dependencies=[may_read],
    )
    async def values_parquet(
        device: str,
        name: Annotated[list[str] | None, Query()] = None,
        begin: Time = None,
        end: Time = None,
    ) -> Response:
        """Return every stored value as Parquet, with the columns of the CSV. Needs the extra `parquet`."""
        series, interval = await _series(device, name), _interval(begin, end)
        path = await asyncio.to_thread(write_parquet, engine, series, *interval)
        headers = {"Content-Disposition": f'attachment; filename="{device}.parquet"'}
        return StreamingResponse(
            read_and_delete(path), media_type="application/vnd.apache.parquet", headers=headers
        )

    @routes.get("/devices/{device}/forecast", dependencies=[may_read])
    async def forecast_values(
        device: str,
        name: Annotated[str, Query(description="the name of a value")],
        horizon: Annotated[float, Query(ge=60, le=30 * DAY_S, description="seconds ahead")] = DAY_S,
        steps: Annotated[int, Query(ge=1, le=96, description="intervals of the horizon")] = 48,
    ) -> ForecastView:
        """Forecast a value from its history by a simple model, with the error that it had so far."""
        series = await _series(device, [name])
        unit = gateway.device(device).values.get(name)
        prediction = await asyncio.to_thread(_forecast, engine, series[name], horizon, steps, time.time())
        return {"name": name, "unit": None if unit is None else unit.unit, **prediction}  # type: ignore[typeddict-item]

    @app.post(INGEST, tags=["devices"], dependencies=[Depends(OtherCredential("the token of the device"))])
    @max_body(MAX_LINE_BYTES)
    async def ingest(
        device: str, request: Request, authorization: Annotated[str, Header()] = ""
    ) -> dict[str, Any]:
        """Receive a telemetry, state or event message of a device; `Authorization: Bearer` has its token.

        The message is durable when this returns.
        """
        scheme, _, token = authorization.partition(" ")
        reader = gateway.authorized(device, token.strip() if scheme.lower() == "bearer" else "")
        if gateway.writer.is_full:
            raise Problem.translated(
                503,
                "Too much at once",
                "device.database_behind",
                "the database is behind; send the message again in a second",
            )
        answered: asyncio.Future[Sequence[Mapping[str, Any]]] = asyncio.get_running_loop().create_future()
        gateway.receive(reader, [await request.body()], answered.set_result)
        answer = dict((await answered)[0])
        if answer["type"] == "error":
            raise Problem(422, "Message refused", answer["reason"], extra={"code": answer["code"]})
        return answer

    async def _series(device: str, names: list[str] | None) -> dict[str, int]:
        gateway.device(device)
        series = await asyncio.to_thread(history.series_of, engine, device)
        if names is None:
            return series
        missing = [name for name in names if name not in series]
        if missing:
            raise Problem.translated(
                404,
                "No such value",
                "device.value_unknown",
                '{device} has no stored value "{name}"; it has {known}',
                device=device,
                name=missing[0][:64],
                known=", ".join(series) or "–",
            )
        return {name: series[name] for name in names}


def _forecast(engine: Engine, series: int, horizon_s: float, steps: int, now_s: float) -> dict[str, Any]:
    width_us = int(horizon_s * 1e6 / steps)
    end_us = int(now_s * 1e6) // width_us * width_us  # the present interval is not complete
    season = DAY_S * 1e6 / width_us
    per_day = round(season) if season >= MIN_SEASON_STEPS and abs(season - round(season)) < 1e-6 else None
    count = max(needed_intervals(steps), (per_day or 0) * 3 + steps) + MAX_ORIGINS
    begin_us = end_us - count * width_us
    values = np.full(count, np.nan)
    for point in history.intervals(engine, series, begin_us, end_us, width_us):
        values[(point.t_us - begin_us) // width_us] = point.mean
    try:
        prediction = forecast(values, steps, per_day)
    except TooShort as short:
        raise Problem.translated(
            409,
            "History too short",
            "device.forecast_too_short",
            "a forecast of {hours} h needs values of the last {needed} h, with few gaps; there are "
            "values for {present} h. Ask for a shorter time, or later",
            hours=round(horizon_s / 3600, 1),
            needed=round(short.needed * width_us / HOUR_US, 1),
            present=round(short.present * width_us / HOUR_US, 1),
        ) from None
    times = [(end_us + (step + 0.5) * width_us) / 1e6 for step in range(steps)]
    band = zip(
        times, prediction.mean.tolist(), prediction.low.tolist(), prediction.high.tolist(), strict=True
    )
    return {
        "method": prediction.method,
        "error": prediction.error,
        "naiveError": prediction.naive_error,
        "origins": prediction.origins,
        "coverage": COVERAGE,
        "points": [{"t": t, "mean": mean, "low": low, "high": high} for t, mean, low, high in band],
    }


def _interval(begin: float | None, end: float | None) -> tuple[int, int]:
    end_s = time.time() + 1 if end is None else end
    begin_s = end_s - DAY_S if begin is None else begin
    if begin_s >= end_s:
        raise Problem.translated(
            422, "No interval", "device.no_interval", "begin must be before end, both in seconds since 1970"
        )
    return int(begin_s * 1e6), int(end_s * 1e6)


def _csv(engine: Engine, series: Mapping[str, int], begin_us: int, end_us: int) -> Iterator[bytes]:
    text = io.StringIO()
    lines = csv.writer(text)
    lines.writerow(("time", "name", "value", "count", "minimum", "maximum"))
    rows = history.every_value(engine, series, begin_us, end_us)
    while True:
        yield text.getvalue().encode()
        text.seek(0)
        text.truncate()
        page = list(islice(rows, ROWS_AT_ONCE))
        if not page:
            return
        lines.writerows(
            (iso(datetime.fromtimestamp(p.t_us / 1e6, UTC)), name, p.mean, p.n, p.min, p.max)
            for name, p in page
        )
