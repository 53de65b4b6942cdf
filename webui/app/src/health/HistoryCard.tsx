/** The history of one value; what was not valid is missing in it. */
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import type { HistoryPoint, PersonView } from "~/api/generated/human-state";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { SegmentedControl } from "~/design/SegmentedControl";
import { Select } from "~/design/Select";
import { HistoryChart } from "~/devices/history/HistoryChart";
import { columnsOf, lastInterval, summaryOf, type Interval } from "~/devices/history/interval";
import { useCoarseNow } from "~/live/clock";
import { useChoice } from "~/route/choice";
import { DRAWN, numberText, pathOf, pointsOf, SERVICE, symbolOf } from "./health";

const REFRESH_MS = 30_000;
const POINTS = 720;
const SPANS = ["hour", "day", "week", "month"] as const;
const UNITS: Record<string, string> = { heartRate: "BPM", breathingRate: "C94", hrvRmssd: "C26", spo2: "P1", bodyMovement: "P1", skinTemperature: "CEL" };

export function HistoryCard({ person }: { person: PersonView }) {
  const { t } = useTranslation("health");
  return (
    <Card title={t("history.title")} className="health__history">
      {person.purposes.includes("history") ? <History person={person.person} /> : <p className="quiet">{t("history.off")}</p>}
    </Card>
  );
}

function History({ person }: { person: string }) {
  const { t, i18n } = useTranslation(["health", "devices"]);
  const [feature, setFeature] = useChoice("value", DRAWN, "heartRate");
  const [chosen, setSpan] = useChoice("span", SPANS, "hour");
  const [zoom, setZoom] = useState<Interval | null>(null);
  const last = lastInterval(chosen, useCoarseNow(REFRESH_MS) / 1000);
  const interval = useMemo(() => zoom ?? { begin: last.begin, end: last.end }, [zoom, last.begin, last.end]);
  const iso = (seconds: number) => encodeURIComponent(new Date(seconds * 1000).toISOString());
  // The service thins what it stores: so many points, of the part that is shown.
  const path = `${pathOf(person)}/history/${feature}/points?start=${iso(interval.begin)}&end=${iso(interval.end)}&count=${POINTS}`;
  const { value, failure } = useServiceQuery<HistoryPoint[]>(SERVICE, path, { keepsPrevious: true });
  const points = useMemo(() => pointsOf(value ?? []), [value]);
  const data = useMemo(() => columnsOf(points, Math.max(2, (interval.end - interval.begin) / POINTS)), [points, interval]);
  const summary = summaryOf(points);
  const name = t(`feature.${feature}`);
  const symbol = symbolOf(feature, UNITS[feature] ?? null);
  const text = (number: number) => `${numberText(feature, number, i18n.language)} ${symbol}`.trim();
  const said = summary === null ? t("history.empty") : t("history.summary", { min: text(summary.min), mean: text(summary.mean), max: text(summary.max) });
  return (
    <>
      <div className="health__history-bar">
        <Select label={t("history.value")} value={feature} options={DRAWN.map((each) => ({ value: each, name: t(`feature.${each}`) }))} onChange={setFeature} />
        <SegmentedControl
          label={t("history.span")}
          value={chosen}
          options={SPANS.map((each) => ({ value: each, name: t(`devices:history.spans.${each}`) }))}
          onChange={(next) => {
            setZoom(null);
            setSpan(next);
          }}
        />
        {zoom !== null && <Button onPress={() => setZoom(null)}>{t("history.whole")}</Button>}
      </div>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <p className="quiet small">
        {said}
      </p>
      <HistoryChart data={data} interval={interval} symbol={symbol} language={i18n.language} label={`${name}: ${said}`} onZoom={setZoom} />
    </>
  );
}
