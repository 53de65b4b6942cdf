/** The weeks in which a person exercised: the score, and the highest difficulty. */
import { useEffect, useRef } from "react";
import { useTranslation } from "react-i18next";
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import type { WeekView } from "~/api/generated/whole-body-control";
import { number, percent } from "~/design/numbers";
import { useShownTheme } from "~/shell/theme";

export function ProgressChart({ weeks }: { weeks: readonly WeekView[] }) {
  const { t, i18n } = useTranslation("humanoid");
  const place = useRef<HTMLDivElement>(null);
  const theme = useShownTheme();
  useEffect(() => {
    const host = place.current;
    if (host === null) return;
    const plot = new uPlot(optionsOf(host, weeks, i18n.language), [weeks.map((_, index) => index), weeks.map(({ score }) => score), weeks.map(({ bestLevel }) => 100 * bestLevel)], host);
    const resized = new ResizeObserver(() => plot.setSize({ width: host.clientWidth, height: host.clientHeight }));
    resized.observe(host);
    return () => {
      resized.disconnect();
      plot.destroy();
    };
  }, [weeks, i18n.language, theme]);
  const last = weeks.at(-1);
  const said = last === undefined ? "" : t("progress.said", { week: last.week, sessions: last.sessions, score: number(last.score, i18n.language), level: percent(last.bestLevel, i18n.language) });
  return (
    <figure className="humanoid-progress">
      <div ref={place} className="humanoid-progress__plot" role="img" aria-label={said} />
      <figcaption className="small quiet">{said}</figcaption>
    </figure>
  );
}

// eslint-disable-next-line @typescript-eslint/no-unsafe-enum-assignment -- uPlot's constant enumeration has no values here
const RIGHT: uPlot.Axis.Side.Right = 1;

function optionsOf(host: HTMLElement, weeks: readonly WeekView[], language: string): uPlot.Options {
  const style = getComputedStyle(host);
  const colour = (name: string) => style.getPropertyValue(name).trim();
  const axis = { stroke: colour("--text-quiet"), font: `12px ${style.fontFamily}`, grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false } };
  return {
    width: host.clientWidth,
    height: host.clientHeight,
    legend: { show: false },
    cursor: { show: false },
    scales: { x: { time: false, range: () => [-0.5, weeks.length - 0.5] }, y: { range: (_, _least, most) => [0, Math.max(1, 1.1 * most)] }, level: { range: [0, 100] } },
    axes: [
      { ...axis, incrs: [1, 2, 4, 8, 13, 26], values: (_, splits) => splits.map((index) => weeks[index]?.week ?? "") },
      { ...axis, size: 48, values: (_, splits) => splits.map((value) => number(value, language)) },
      { ...axis, scale: "level", side: RIGHT, size: 52, grid: { show: false }, values: (_, splits) => splits.map((value) => percent(value / 100, language)) },
    ],
    series: [
      {},
      { label: "score", stroke: colour("--accent"), width: 2, points: { show: true, size: 7, fill: colour("--accent") } },
      { label: "level", scale: "level", stroke: colour("--attention"), width: 2, dash: [6, 4], points: { show: true, size: 7 } },
    ],
  };
}
