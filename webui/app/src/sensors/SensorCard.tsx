/** A device with its live values and a small chart of each. */
import { ChartLine, Ruler, TimerOff } from "lucide-react";
import { memo, useEffect, useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import type { SeriesView } from "~/api/generated/device-gateway";
import { useServiceQuery } from "~/api/useServiceQuery";
import { RelativeTime } from "~/design/RelativeTime";
import { ConditionBadge } from "~/devices/ConditionBadge";
import { pathOf, SERVICE, type SymbolOf } from "~/devices/gateway";
import { KindIcon } from "~/devices/KindIcon";
import { digits, isoOf, outOfRange, spaced, titleOf, valuesOf, type ShownValue } from "~/devices/values";
import { useCoarseNow } from "~/live/clock";
import type { RegisteredDeviceView } from "~/live/messages";
import { addresses } from "~/places/addresses";
import { Battery } from "~/cell/Battery";
import { SPARK_POINTS, SPARK_S, Sparkline } from "./Sparkline";
import type { SparkPoint } from "./spark";

const MAX_VALUES = 4;
const REFRESH_MS = 60_000;
/** Less than the chart can show, so that many cards are not drawn for the clock alone. */
const CHART_STEP_MS = 15_000;
/** A card that is scrolled past loads nothing. */
const SETTLE_MS = 400;
const NOTHING: readonly SparkPoint[] = [];

export const SensorCard = memo(function SensorCard({ device, symbolOf }: { device: RegisteredDeviceView; symbolOf: SymbolOf }) {
  const { t } = useTranslation("devices");
  const values = valuesOf(device);
  // The positions of joints are of interest where nothing else is measured.
  const measured = device.sensors.length > 0 ? values.filter(({ sensor }) => sensor !== null) : values;
  const shown = measured.slice(0, MAX_VALUES);
  const history = useRecentHistory(device.name, shown.some(({ latest }) => latest !== null));
  const title = titleOf(device);
  return (
    <article className="sensor-card" aria-label={title}>
      <header className="sensor-card__head">
        <KindIcon kind={device.kind} />
        <h3>{title}</h3>
        <ConditionBadge device={device} />
        {device.batteryLevel !== null && <Battery level={device.batteryLevel} />}
      </header>
      {shown.length === 0 ? (
        <p className="quiet">{t("sensors.noValues")}</p>
      ) : (
        <ul className="sensor-card__values">
          {shown.map((value) => (
            <Value key={value.name} value={value} symbol={symbolOf(value.unit)} points={history.get(value.name) ?? NOTHING} />
          ))}
        </ul>
      )}
      <footer className="sensor-card__foot">
        {values.length > shown.length && <span className="quiet small">{t("sensors.more", { count: values.length - shown.length })}</span>}
        <Link href={addresses.device(device.name, { part: "history" })} className="sensor-card__link" aria-label={t("sensors.historyOf", { name: title })}>
          <ChartLine aria-hidden size={18} />
          {t("part.history")}
        </Link>
      </footer>
    </article>
  );
});

function Value({ value, symbol, points }: { value: ShownValue; symbol: string; points: readonly SparkPoint[] }) {
  const { t, i18n } = useTranslation("devices");
  const { latest, name, sensor } = value;
  const fault = outOfRange(value);
  const isStale = latest === null || latest.stale;
  const now = Math.max(useCoarseNow(CHART_STEP_MS) / 1000, latest?.t ?? 0);
  const drawn = useMemo(() => (latest === null ? points : [...points, { t: latest.t, mean: latest.value }]), [points, latest]);
  const limit = fault === "below" ? sensor?.minimum : sensor?.maximum;
  return (
    <li className="sensor-value" data-stale={isStale || undefined} data-fault={(fault !== null && !isStale) || undefined}>
      <span className="sensor-value__name">{t(`value.${name}`, { defaultValue: spaced(name) })}</span>
      <span className="sensor-value__number">
        <output>{latest === null ? "–" : digits(latest.value, i18n.language)}</output>
        {latest !== null && symbol !== "" && <span className="sensor-value__unit"> {symbol}</span>}
      </span>
      <Sparkline points={drawn} now={now} isStale={isStale} />
      <span className="sensor-value__state small">
        {fault !== null && (
          <span className="sensor-value__mark">
            <Ruler aria-hidden size={14} /> {t(`sensors.${fault}`, { limit: `${digits(limit ?? 0, i18n.language)} ${symbol}`.trim() })}
          </span>
        )}
        {latest === null ? (
          <span className="sensor-value__mark">
            <TimerOff aria-hidden size={14} /> {t("sensors.noValueYet")}
          </span>
        ) : (
          <span className="sensor-value__mark">
            {isStale && (
              <>
                <TimerOff aria-hidden size={14} /> {t("sensors.stale")} ·{" "}
              </>
            )}
            <RelativeTime at={isoOf(latest.t)} />
          </span>
        )}
      </span>
    </li>
  );
}

/** The values of the last half hour by name, loaded when the card has been in view for a moment. */
function useRecentHistory(device: string, isWanted: boolean): ReadonlyMap<string, readonly SparkPoint[]> {
  const [begin, setBegin] = useState<number | null>(null);
  useEffect(() => {
    const timer = setTimeout(() => setBegin(Math.floor(Date.now() / 1000) - SPARK_S), SETTLE_MS);
    return () => clearTimeout(timer);
  }, []);
  const path = begin === null || !isWanted ? null : `${pathOf(device)}/values?begin=${begin}&points=${SPARK_POINTS}`;
  const { value } = useServiceQuery<SeriesView[]>(SERVICE, path, { intervalMs: REFRESH_MS });
  return useMemo(() => new Map((value ?? []).map((series) => [series.name, series.points])), [value]);
}
