/** The delay of the control over the last seconds, as two curves. */
import { useEffect, useRef } from "react";
import { useTranslation } from "react-i18next";
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { FrameScheduler } from "~/design/frameScheduler";
import { number } from "~/design/numbers";
import type { ControlConnection } from "./connection";
import { KEPT_S, topOf } from "./latency";

const STEP_S = 10;

export function DelayChart({ connection, label }: { connection: ControlConnection; label: string }) {
  const { t, i18n } = useTranslation("control");
  const place = useRef<HTMLDivElement>(null);
  const seconds = t("unit.s");
  const language = i18n.language;
  useEffect(() => {
    const host = place.current;
    if (host === null) return;
    const { delays } = connection;
    const plot = new uPlot(optionsOf(host, language, seconds), delays.columns(performance.now()), host);
    const frames = new FrameScheduler(host, () => {
      plot.setData(delays.columns(performance.now()), true);
      return false;
    });
    const unsubscribe = connection.subscribe(() => frames.request());
    const resized = new ResizeObserver(() => plot.setSize({ width: host.clientWidth, height: host.clientHeight }));
    resized.observe(host);
    return () => {
      frames.dispose();
      unsubscribe();
      resized.disconnect();
      plot.destroy();
    };
  }, [connection, language, seconds]);
  return <div className="delay__chart" ref={place} role="img" aria-label={label} />;
}

function optionsOf(host: HTMLElement, language: string, seconds: string): uPlot.Options {
  // Read at each drawing, since the theme may change.
  const colour = (name: string) => () => getComputedStyle(host).getPropertyValue(name).trim();
  const axis = { stroke: colour("--text-quiet"), font: `12px ${getComputedStyle(host).fontFamily}`, grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false } };
  const line = (name: string, dash: number[]) => ({ stroke: colour(name), width: 2, dash, points: { show: false }, spanGaps: true });
  return {
    width: host.clientWidth,
    height: host.clientHeight,
    legend: { show: false },
    cursor: { show: false },
    scales: { x: { time: false, range: [-KEPT_S, 0] }, y: { range: (_, __, most) => [0, topOf(most)] } },
    axes: [
      {
        ...axis,
        size: 24,
        splits: Array.from({ length: KEPT_S / STEP_S + 1 }, (_, index) => index * STEP_S - KEPT_S),
        values: (_, splits) => splits.map((at) => `${number(at, language)} ${seconds}`),
      },
      { ...axis, size: 68, splits: (_, __, ___, most) => [0, most / 2, most], values: (_, splits) => splits.map((value) => `${number(value, language)} ms`) },
    ],
    series: [{}, line("--accent", []), line("--attention", [6, 4])],
  };
}
