/** Throughput: how many processes started, completed and failed, by hour or by day. */
import { useEffect, useMemo, useRef } from "react";
import { useTranslation } from "react-i18next";
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import type { ThroughputPoint } from "~/api/generated/task-orchestrator";
import { number } from "~/design/numbers";
import { useNow } from "~/live/clock";
import { useShownTheme } from "~/shell/theme";
import { pointsOf, stepsOf, type Period, type PlotStep, type Points } from "../query";

const LINES = [
  { count: "started", colour: "--accent", dash: [6, 4] },
  { count: "completed", colour: "--ok", dash: [] },
  { count: "failed", colour: "--stop", dash: [2, 3] },
] as const;
const HOUR_MS = 3_600_000;

export function ThroughputChart({ points, period }: { points: readonly ThroughputPoint[]; period: Period }) {
  const { t, i18n } = useTranslation("cockpit");
  const hour = Math.floor(useNow() / HOUR_MS) * HOUR_MS;
  const { shown } = stepsOf(period, hour);
  const shownPoints = useMemo(() => pointsOf(points, shown), [points, shown]);
  const place = usePlot(shownPoints, shown, i18n.language);
  const sums = LINES.map(({ count }) => ({ count, sum: shownPoints[count].reduce((sum, value) => sum + value, 0) }));
  const said = sums.map(({ count, sum }) => `${t(`totals.${count}`)}: ${number(sum, i18n.language)}`).join(", ");
  return (
    <figure className="throughput">
      <div ref={place} className="throughput__plot" role="img" aria-label={t(`throughput.${shown}`, { sums: said })} />
      <figcaption className="throughput__legend">
        {LINES.map(({ count, colour, dash }) => (
          <span key={count}>
            <svg aria-hidden width="24" height="8">
              <line x1="0" y1="4" x2="24" y2="4" stroke={`var(${colour})`} strokeWidth="2.5" strokeDasharray={dash.join(" ")} />
            </svg>
            {t(`totals.${count}`)}
          </span>
        ))}
        <span className="quiet">{t(`throughput.per.${shown}`)}</span>
      </figcaption>
    </figure>
  );
}

function usePlot(points: Points, step: PlotStep, language: string) {
  const place = useRef<HTMLDivElement>(null);
  const plot = useRef<uPlot>(null);
  const newest = useRef(points);
  const theme = useShownTheme();

  useEffect(() => {
    newest.current = points;
    plot.current?.setData(dataOf(points, step));
  }, [points, step]);

  useEffect(() => {
    const host = place.current;
    if (host === null) return;
    const made = new uPlot(optionsOf(host, step, language), dataOf(newest.current, step), host);
    plot.current = made;
    const resized = new ResizeObserver(() => made.setSize({ width: host.clientWidth, height: host.clientHeight }));
    resized.observe(host);
    return () => {
      resized.disconnect();
      made.destroy();
      plot.current = null;
    };
  }, [step, language, theme]);

  return place;
}

/** The last hour or day is as wide as the others: its values are repeated at its end. */
function dataOf({ at, started, completed, failed }: Points, step: PlotStep): uPlot.AlignedData {
  const repeated = (values: number[]) => [...values, values.at(-1) ?? 0];
  const end = (at.at(-1) ?? 0) + (step === "hour" ? HOUR_MS : 24 * HOUR_MS) / 1000;
  return [[...at, end], repeated(started), repeated(completed), repeated(failed)];
}

function optionsOf(host: HTMLElement, step: PlotStep, language: string): uPlot.Options {
  const style = getComputedStyle(host);
  const colour = (name: string) => style.getPropertyValue(name).trim();
  const axis = { stroke: colour("--text-quiet"), font: `12px ${style.fontFamily}`, grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false } };
  const day = new Intl.DateTimeFormat(language, { day: "numeric", month: "short" });
  const hour = new Intl.DateTimeFormat(language, { hour: "2-digit", minute: "2-digit", hourCycle: "h23" });
  const stepped = uPlot.paths.stepped?.({ align: 1 });
  return {
    width: host.clientWidth,
    height: host.clientHeight,
    legend: { show: false },
    cursor: { show: false },
    scales: { x: { time: true }, y: { range: (_, _least, most) => [0, Math.max(1, most * 1.1)] } },
    axes: [
      {
        ...axis,
        space: 70,
        values: (_, splits) =>
          splits.map((at) => {
            const moment = new Date(at * 1000);
            return step === "hour" && moment.getHours() + moment.getMinutes() > 0 ? hour.format(moment) : day.format(moment);
          }),
      },
      { ...axis, size: 44, incrs: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 100_000], values: (_, splits) => splits.map((value) => number(value, language)) },
    ],
    series: [
      {},
      ...LINES.map(({ count, colour: name, dash }) => ({
        label: count,
        stroke: colour(name),
        width: 2,
        dash: [...dash],
        points: { show: false },
        ...(stepped === undefined ? {} : { paths: stepped }),
      })),
    ],
  };
}
