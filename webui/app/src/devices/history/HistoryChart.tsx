/**
 * The values of one series over time: the mean as a line within the band from minimum to maximum; a forecast as a broken
 * line within its band. Dragging zooms.
 */
import { useEffect, useMemo, useRef } from "react";
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { exactTime } from "~/design/times";
import { useShownTheme } from "~/shell/theme";
import { digits, isoOf } from "../values";
import { withForecast, type Columns, type ForecastColumns, type Interval } from "./interval";

interface HistoryChartProps {
  data: Columns | ForecastColumns;
  interval: Interval;
  symbol: string;
  language: string;
  /** For screen readers. */
  label: string;
  onZoom: (interval: Interval) => void;
}

/** A drag by less is a press. */
const MIN_DRAG_PX = 8;

export function HistoryChart({ data: given, interval, symbol, language, label, onZoom }: HistoryChartProps) {
  const place = useRef<HTMLDivElement>(null);
  const readout = useRef<HTMLOutputElement>(null);
  const plot = useRef<uPlot>(null);
  const data = useMemo(() => (given.length === 7 ? given : withForecast(given, [])), [given]);
  const newest = useRef({ data, interval, onZoom });
  const theme = useShownTheme();

  useEffect(() => {
    newest.current = { data, interval, onZoom };
    plot.current?.setData(data, false);
    plot.current?.setScale("x", { min: interval.begin, max: interval.end });
  }, [data, interval, onZoom]);

  useEffect(() => {
    const host = place.current;
    if (host === null) return;
    const options = optionsOf(host, language, newest.current.interval);
    const made = new uPlot(
      {
        ...options,
        hooks: {
          setSelect: [
            (chart) => {
              const { left, width } = chart.select;
              if (width >= MIN_DRAG_PX) newest.current.onZoom({ begin: chart.posToVal(left, "x"), end: chart.posToVal(left + width, "x") });
              chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
            },
          ],
          setCursor: [
            ({ cursor: { idx } }) => {
              const out = readout.current;
              if (out === null) return;
              out.textContent = readoutOf(newest.current.data, idx ?? -1, symbol, language);
            },
          ],
        },
      },
      newest.current.data,
      host,
    );
    plot.current = made;
    made.setScale("x", { min: newest.current.interval.begin, max: newest.current.interval.end });
    const resized = new ResizeObserver(() => made.setSize({ width: host.clientWidth, height: host.clientHeight }));
    resized.observe(host);
    return () => {
      resized.disconnect();
      made.destroy();
      plot.current = null;
    };
  }, [language, theme, symbol]);

  return (
    <div className="history-chart">
      <div ref={place} className="history-chart__plot" role="img" aria-label={label} />
      <output ref={readout} className="history-chart__readout small" aria-hidden />
    </div>
  );
}

/** The value at a moment; of a forecast its band as well. */
function readoutOf(columns: ForecastColumns, idx: number, symbol: string, language: string): string {
  const [t, mean] = [columns[0][idx], columns[3][idx]];
  if (t === undefined) return "";
  const at = exactTime(isoOf(t), language);
  if (mean != null) return `${digits(mean, language)} ${symbol} · ${at}`;
  const [low, high, expected] = [columns[4][idx], columns[5][idx], columns[6][idx]];
  if (low == null || high == null || expected == null) return "";
  return `≈ ${digits(expected, language)} ${symbol} (${digits(low, language)} – ${digits(high, language)}) · ${at}`;
}

function optionsOf(host: HTMLElement, language: string, interval: Interval): uPlot.Options {
  const style = getComputedStyle(host);
  const colour = (name: string) => style.getPropertyValue(name).trim();
  const axis = { stroke: colour("--text-quiet"), font: `12px ${style.fontFamily}`, grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false } };
  const day = new Intl.DateTimeFormat(language, { day: "numeric", month: "short" });
  const minute = new Intl.DateTimeFormat(language, { hour: "2-digit", minute: "2-digit", hourCycle: "h23" });
  const second = new Intl.DateTimeFormat(language, { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23" });
  const band = { stroke: "transparent", points: { show: false } };
  return {
    width: host.clientWidth,
    height: host.clientHeight,
    legend: { show: false },
    // All charts of a device show the same moment.
    cursor: { drag: { x: true, y: false, setScale: false }, sync: { key: "device-history" }, points: { size: 8 } },
    scales: { x: { time: true, min: interval.begin, max: interval.end } },
    axes: [
      {
        ...axis,
        size: 32,
        space: 80,
        values: (_, splits, __, ___, step) =>
          splits.map((at) => {
            const moment = new Date(at * 1000);
            if (step < 60) return second.format(moment);
            return moment.getHours() + moment.getMinutes() === 0 ? day.format(moment) : minute.format(moment);
          }),
      },
      { ...axis, size: 64, values: (_, splits) => splits.map((value) => digits(value, language)) },
    ],
    // Bands are filled when their upper series is drawn: the lines come last, so that they lie above them.
    series: [{}, band, band, { stroke: colour("--accent"), width: 2 }, band, band, { stroke: colour("--accent"), width: 2, dash: [6, 4], points: { show: false } }],
    bands: [
      { series: [2, 1], fill: colour("--accent-soft") },
      { series: [5, 4], fill: colour("--accent-soft") },
    ],
  };
}
