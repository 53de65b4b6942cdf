/** Charts of the values of a device, each with its own scale, over the same time; and their download. */
import { ChevronLeft, ChevronRight, Download, RotateCcw, TrendingUp, ZoomIn, ZoomOut } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { ToggleButton, ToggleButtonGroup } from "react-aria-components";
import type { ForecastView, SeriesView } from "~/api/generated/device-gateway";
import { save } from "~/api/download";
import { errorText, requestFile } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { SegmentedControl } from "~/design/SegmentedControl";
import { number } from "~/design/numbers";
import { exactTime } from "~/design/times";
import { useNow } from "~/live/clock";
import type { RegisteredDeviceView } from "~/live/messages";
import { UnknownAddress } from "~/route/choice";
import { UnknownName } from "~/route/UnknownName";
import { useQueryChange, useQueryParameter } from "~/route/queryParameter";
import { pathOf, SERVICE, type SymbolOf } from "../gateway";
import { digits, isoOf, spaced, valuesOf } from "../values";
import { HistoryChart } from "./HistoryChart";
import { columnsOf, HORIZONS, intervalIn, intervalText, isSpan, lastInterval, moved, SPANS, summaryOf, withForecast, zoomed, type Interval } from "./interval";

const POINTS = 600;
const INITIAL_CHARTS = 3;
const FORECAST_EVERY_MS = 60_000;
const NONE: readonly SeriesView[] = [];

export function HistoryPart({ device, symbolOf }: { device: RegisteredDeviceView; symbolOf: SymbolOf }) {
  const { t, i18n } = useTranslation("devices");
  const names = useMemo(() => valuesOf(device).filter(({ latest }) => latest !== null).map(({ name }) => name), [device]);
  const [wanted, setWanted] = useQueryParameter("values");
  const [span] = useQueryParameter("span", "hour");
  const change = useQueryChange();
  const [zoom, setZoom] = useQueryParameter("time");
  const [ahead, setAhead] = useQueryParameter("forecast");
  if (!isSpan(span)) throw new UnknownAddress("span", span);
  if (!["", "on"].includes(ahead)) throw new UnknownAddress("forecast", ahead);
  if (zoom !== "" && intervalIn(zoom) === null) throw new UnknownAddress("time", zoom);
  const hasForecast = ahead === "on";
  const [fault, setFault] = useState<string | null>(null);
  const [isSaving, setSaving] = useState(false);
  const fixed = useMemo(() => intervalIn(zoom), [zoom]);
  const last = lastInterval(span, useNow() / 1000);
  const interval = useMemo(() => fixed ?? { begin: last.begin, end: last.end }, [fixed, last.begin, last.end]);
  const horizon = HORIZONS[span];
  // The latest values leave room for what is ahead; a chosen period stays as it is.
  const shown = useMemo(() => (hasForecast && fixed === null ? { begin: interval.begin, end: interval.end + horizon.seconds } : interval), [hasForecast, fixed, interval, horizon]);
  const chosen = wanted === "" ? names.slice(0, INITIAL_CHARTS) : names.filter((name) => wanted.split(",").includes(name));
  const query = `${chosen.map((name) => `name=${encodeURIComponent(name)}&`).join("")}begin=${interval.begin}&end=${interval.end}`;
  const path = chosen.length === 0 ? null : `${pathOf(device.name)}/values`;
  // The path without the time stays, so that the charts keep their values while the next ones load.
  const { value, failure } = useSeries(path, query);
  const set = (next: Interval) => setZoom(intervalText(next));
  const title = (name: string) => t(`value.${name}`, { defaultValue: spaced(name) });
  // Not a link: without pyarrow the gateway refuses it, and the browser would hide the reason.
  const saveParquet = async () => {
    setSaving(true);
    setFault(null);
    try {
      save(`${device.name}.parquet`, await requestFile(`${SERVICE}/${pathOf(device.name)}/values.parquet?${query}`));
    } catch (error) {
      setFault(errorText(error));
    } finally {
      setSaving(false);
    }
  };
  const at = (seconds: number) => exactTime(isoOf(seconds), i18n.language);
  const unknown = wanted === "" ? [] : wanted.split(",").filter((name) => !names.includes(name));
  if (names.length > 0 && unknown.length > 0) return <UnknownName thing="value" name={unknown.join(", ")} parameter="values" />;
  if (names.length === 0) return <p className="quiet">{t("history.none")}</p>;
  return (
    <div className="device-history">
      <div className="device-history__bar">
        <SegmentedControl
          label={t("history.span")}
          value={fixed === null ? span : "own"}
          options={[...Object.keys(SPANS).map((value) => ({ value, name: t(`history.spans.${value}`) })), ...(fixed === null ? [] : [{ value: "own", name: t("history.own") }])]}
          onChange={(next) => {
            if (next === "own") return;
            change({ time: "", span: next });
          }}
        />
        <div className="device-history__zoom" role="group" aria-label={t("history.zoom")}>
          <Button label={t("history.earlier")} icon={<ChevronLeft aria-hidden size={20} />} onPress={() => set(moved(interval, -0.5))} />
          <Button label={t("history.later")} icon={<ChevronRight aria-hidden size={20} />} onPress={() => set(moved(interval, 0.5))} />
          <Button label={t("history.nearer")} icon={<ZoomIn aria-hidden size={20} />} onPress={() => set(zoomed(interval, 0.5))} />
          <Button label={t("history.farther")} icon={<ZoomOut aria-hidden size={20} />} onPress={() => set(zoomed(interval, 2))} />
          <Button label={t("history.reset")} icon={<RotateCcw aria-hidden size={20} />} onPress={() => setZoom("")} isDisabled={fixed === null} />
        </div>
        <ToggleButton className="device-history__value" isSelected={hasForecast} onChange={(isOn) => setAhead(isOn ? "on" : "")}>
          <TrendingUp aria-hidden size={18} />
          {t("history.forecast.show")}
        </ToggleButton>
        <a className="button button--plain button--normal" href={`/api/${SERVICE}/${pathOf(device.name)}/values.csv?${query}`} download={`${device.name}.csv`}>
          <Download aria-hidden size={18} />
          {t("history.csv")}
        </a>
        <Button icon={<Download aria-hidden size={18} />} isDisabled={isSaving} onPress={() => void saveParquet()}>
          {t("history.parquet")}
        </Button>
      </div>
      <ToggleButtonGroup className="device-history__values" aria-label={t("history.values")} selectionMode="multiple" selectedKeys={chosen} onSelectionChange={(keys) => setWanted(names.filter((name) => keys.has(name)).join(",") || (names[0] ?? ""))}>
        {names.map((name) => (
          <ToggleButton key={name} id={name} className="device-history__value">
            {title(name)}
          </ToggleButton>
        ))}
      </ToggleButtonGroup>
      <p className="quiet small">
        {at(shown.begin)} – {at(shown.end)} · {t("history.hint")}
      </p>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {fault !== null && <ErrorMessage>{fault}</ErrorMessage>}
      {chosen.map((name) => {
        const series = value.find((each) => each.name === name);
        const symbol = symbolOf(series?.unit ?? device.values[name]?.unit);
        const forecastPath = hasForecast ? `${pathOf(device.name)}/forecast?name=${encodeURIComponent(name)}&horizon=${horizon.seconds}&steps=${horizon.steps}` : null;
        return <Series key={name} title={title(name)} series={series ?? null} symbol={symbol} interval={shown} valuesEnd={interval.end} forecastPath={forecastPath} onZoom={set} />;
      })}
    </div>
  );
}

interface SeriesProps {
  title: string;
  series: SeriesView | null;
  symbol: string;
  interval: Interval;
  /** Until when the interval has values; then a forecast. */
  valuesEnd: number;
  forecastPath: string | null;
  onZoom: (interval: Interval) => void;
}

function Series({ title, series, symbol, interval, valuesEnd, forecastPath, onZoom }: SeriesProps) {
  const { t, i18n } = useTranslation("devices");
  const points = series?.points;
  const { value: forecast, failure } = useServiceQuery<ForecastView>(SERVICE, forecastPath, { intervalMs: FORECAST_EVERY_MS });
  const data = useMemo(() => {
    const columns = columnsOf(points ?? [], (valuesEnd - interval.begin) / POINTS);
    return withForecast(columns, forecast?.points ?? []);
  }, [points, interval, valuesEnd, forecast]);
  const summary = summaryOf(points ?? []);
  const text = (value: number) => `${digits(value, i18n.language)} ${symbol}`.trim();
  const said = summary === null ? t("history.empty") : t("history.summary", { min: text(summary.min), mean: text(summary.mean), max: text(summary.max) });
  return (
    <section className="device-history__series" aria-label={title}>
      <header>
        <h3>
          {title} {symbol !== "" && <span className="quiet">({symbol})</span>}
        </h3>
        <span className="quiet small">{points === undefined ? "" : said}</span>
      </header>
      <HistoryChart data={data} interval={interval} symbol={symbol} language={i18n.language} label={`${title}: ${said}`} onZoom={onZoom} />
      {forecastPath !== null && <ForecastText forecast={forecast} failure={failure} symbol={symbol} />}
    </section>
  );
}

/** How a forecast was made, and how wrong earlier ones were. */
function ForecastText({ forecast, failure, symbol }: { forecast: ForecastView | null; failure: string | null; symbol: string }) {
  const { t, i18n } = useTranslation("devices");
  if (failure !== null) return <p className="quiet small">{failure}</p>;
  const last = forecast?.points.at(-1);
  if (forecast === null || last === undefined) return <p className="quiet small">{t("history.forecast.loading")}</p>;
  const { method, error, naiveError, origins, coverage } = forecast;
  const text = (value: number) => `${digits(value, i18n.language)} ${symbol}`.trim();
  const rough = (value: number) => `${number(value, i18n.language, { maximumSignificantDigits: 2 })} ${symbol}`.trim();
  return (
    <p className="small">
      {t(`history.forecast.method.${method}`, { until: exactTime(isoOf(last.t), i18n.language), value: text(last.mean), low: text(last.low), high: text(last.high) })}{" "}
      {t("history.forecast.error", { count: origins, error: rough(error), naive: rough(naiveError), percent: Math.round(100 * coverage) })}{" "}
      {error >= naiveError && <strong>{t("history.forecast.useless")}</strong>}
    </p>
  );
}

/** The series of an interval; those of the interval before while the next ones load. */
function useSeries(path: string | null, query: string) {
  const { value, failure } = useServiceQuery<SeriesView[]>(SERVICE, path === null ? null : `${path}?points=${POINTS}&${query}`, { keepsPrevious: true });
  return { value: value ?? NONE, failure };
}
