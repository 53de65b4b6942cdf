/** The live strip of the five bends: half a minute, thirty times a second at most, and only while it is seen. */
import { useEffect, useRef } from "react";
import { useTranslation } from "react-i18next";
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { useLive, usePick } from "~/live/hooks";
import type { Finger } from "~/live/messages";
import { useShownTheme } from "~/shell/theme";
import { BendHistory } from "./bend_history";
import "./BendStrip.css";

const fingers: readonly Finger[] = ["thumb", "index", "middle", "ring", "little"];
/** Lines are told apart without colour as well. */
const dashes = [[], [10, 4], [3, 3], [10, 3, 3, 3], [16, 5]];
const HEIGHT_PX = 200;

export default function BendStrip({ glove }: { glove: string }) {
  const { t, i18n } = useTranslation(["system", "hand"]);
  const live = useLive();
  const theme = useShownTheme();
  const place = useRef<HTMLDivElement>(null);
  const language = i18n.language;

  useEffect(() => {
    const host = place.current;
    if (host === null) return;
    const history = new BendHistory();
    const plot = new uPlot(options(host, history.seconds, language), columnsOf(history), host);
    let frame = 0;
    let isSeen = true;
    const draw = () => {
      frame = 0;
      plot.setData(columnsOf(history), false);
      const now = Date.now() / 1000;
      plot.setScale("x", { min: now - history.seconds, max: now });
    };
    const drawSoon = () => {
      if (frame === 0 && isSeen && !document.hidden) frame = requestAnimationFrame(draw);
    };
    const topic = `glove/${glove}` as const;
    let last: number[] | null = null;
    const unwatch = live.watch(topic, () => {
      const bend = live.value(topic)?.bend ?? null;
      if (bend === null || bend === last) return;
      last = bend;
      history.push(Date.now() / 1000, bend);
      drawSoon();
    });
    const seen = new IntersectionObserver(([entry]) => {
      isSeen = entry?.isIntersecting ?? true;
      drawSoon();
    });
    seen.observe(host);
    const resized = new ResizeObserver(() => plot.setSize({ width: host.clientWidth, height: HEIGHT_PX }));
    resized.observe(host);
    return () => {
      cancelAnimationFrame(frame);
      unwatch();
      seen.disconnect();
      resized.disconnect();
      plot.destroy();
    };
    // A new theme has new colours, which the plot takes in only at its beginning.
  }, [live, glove, language, theme]);

  return (
    <figure className="bend-strip" aria-label={t("glove.strip")}>
      <div ref={place} className="bend-strip__plot" aria-hidden />
      <figcaption className="bend-strip__legend">
        {fingers.map((finger, number) => (
          <Legend key={finger} glove={glove} finger={finger} number={number} />
        ))}
      </figcaption>
    </figure>
  );
}

function Legend({ glove, finger, number }: { glove: string; finger: Finger; number: number }) {
  const { t } = useTranslation(["system", "hand"]);
  const state = usePick(`glove/${glove}`, (view) => view?.states?.[number] ?? null);
  return (
    <span className="bend-strip__finger">
      <svg width="28" height="8" aria-hidden>
        <line x1="0" x2="28" y1="4" y2="4" strokeWidth="2.5" stroke={`var(--finger-${number})`} strokeDasharray={dashes[number]?.join(" ")} />
      </svg>
      {t(`hand:finger.${finger}`)} <span className="quiet">{state === null ? t("glove.unknown") : t(`glove.bend.${state}`)}</span>
    </span>
  );
}

function columnsOf(history: BendHistory): uPlot.AlignedData {
  return history.columns();
}

function options(host: HTMLElement, seconds: number, language: string): uPlot.Options {
  const style = getComputedStyle(host);
  const colour = (name: string) => style.getPropertyValue(name).trim();
  const axis = { stroke: colour("--text-quiet"), font: `12px ${style.fontFamily}`, grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false } };
  const now = Date.now() / 1000;
  return {
    width: host.clientWidth,
    height: HEIGHT_PX,
    legend: { show: false },
    cursor: { show: false },
    scales: { x: { time: false, min: now - seconds, max: now }, y: { range: (_, least, most) => roomRound(least, most) } },
    axes: [
      {
        ...axis,
        splits: (_, __, min, max) => [30, 20, 10, 0].map((ago) => max - ago).filter((at) => at >= min - 0.01),
        values: (_, splits) => splits.map((at) => `${Math.round(at - (splits.at(-1) ?? at))} s`),
      },
      { ...axis, size: 52, values: (_, splits) => splits.map((value) => value.toLocaleString(language)) },
    ],
    series: [
      {},
      ...fingers.map((finger, number) => ({
        label: finger,
        stroke: colour(`--finger-${number}`),
        width: 2,
        dash: dashes[number] ?? [],
        points: { show: false },
      })),
    ],
  };
}

/** Steps of 250, so that the scale does not breathe with every movement. */
function roomRound(least: number | null, most: number | null): [number, number] {
  if (least === null || most === null) return [0, 2000];
  return [Math.floor(least / 250) * 250, Math.max(Math.ceil(most / 250) * 250, Math.floor(least / 250) * 250 + 250)];
}
