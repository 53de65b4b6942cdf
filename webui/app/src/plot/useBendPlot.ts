/** A live plot of the five bends of a glove, updated at most 30 times a second and only while it is visible. */
import { useEffect, useRef, type RefObject } from "react";
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { FrameScheduler } from "~/design/frameScheduler";
import { number as inWords } from "~/design/numbers";
import { fingers } from "~/hand/geometry";
import { useLive } from "~/live/hooks";
import { BendHistory } from "./bend_history";
import { dashes } from "./fingers";
import "./fingers.css";

/** Creates the options of a plot for its element; it starts at `now` (seconds since 1970). */
export type Look = (host: HTMLElement, seconds: number, now: number) => uPlot.Options;

/**
 * Draw the bends of `glove` into the returned element; another `look` creates the plot again. The plot
 * is returned for custom drawing.
 */
export function useBendPlot(glove: string, seconds: number, look: Look): { place: RefObject<HTMLDivElement | null>; plot: RefObject<uPlot | null> } {
  const live = useLive();
  const place = useRef<HTMLDivElement>(null);
  const plot = useRef<uPlot>(null);
  const history = useRef<{ glove: string; bends: BendHistory }>(null);

  useEffect(() => {
    const host = place.current;
    if (host === null) return;
    // Keep the history when the plot is created again.
    if (history.current?.glove !== glove || history.current.bends.seconds !== seconds) {
      history.current = { glove, bends: new BendHistory(seconds) };
    }
    const { bends } = history.current;
    const made = new uPlot(look(host, seconds, Date.now() / 1000), columnsOf(bends), host);
    plot.current = made;
    const frames = new FrameScheduler(host, () => {
      made.setData(columnsOf(bends), false);
      const now = Date.now() / 1000;
      made.setScale("x", { min: now - seconds, max: now });
      return false;
    });
    const topic = `glove/${glove}` as const;
    let last: number[] | null = null;
    const unwatch = live.watch(topic, () => {
      const bend = live.value(topic)?.bend ?? null;
      if (bend === null || bend === last) return;
      last = bend;
      bends.push(Date.now() / 1000, bend);
      frames.request();
    });
    const resized = new ResizeObserver(() => made.setSize({ width: host.clientWidth, height: host.clientHeight }));
    resized.observe(host);
    return () => {
      frames.dispose();
      unwatch();
      resized.disconnect();
      made.destroy();
      plot.current = null;
    };
  }, [live, glove, seconds, look]);

  return { place, plot };
}

/** The common axes, scales and lines; `width` is the line width by finger. */
export function bendOptions(host: HTMLElement, seconds: number, now: number, language: string, width: (finger: number) => number): uPlot.Options {
  const style = getComputedStyle(host);
  const colour = (name: string) => style.getPropertyValue(name).trim();
  const axis = { stroke: colour("--text-quiet"), font: `12px ${style.fontFamily}`, grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false } };
  const marks = [3, 2, 1, 0].map((third) => (third * seconds) / 3);
  return {
    width: host.clientWidth,
    height: host.clientHeight,
    legend: { show: false },
    cursor: { show: false },
    scales: { x: { time: false, min: now - seconds, max: now }, y: { range: (_, least, most) => roomRound(least, most) } },
    axes: [
      {
        ...axis,
        size: 30,
        splits: (_, __, min, max) => marks.map((ago) => max - ago).filter((at) => at >= min - 0.01),
        values: (_, splits) => splits.map((at) => `${Math.round(at - (splits.at(-1) ?? at))} s`),
      },
      { ...axis, size: 52, values: (_, splits) => splits.map((value) => inWords(value, language)) },
    ],
    series: [
      {},
      ...fingers.map((finger, number) => ({
        label: finger,
        stroke: colour(`--finger-${number}`),
        width: width(number),
        dash: dashes[number] ?? [],
        points: { show: false },
      })),
    ],
  };
}

function columnsOf(history: BendHistory): uPlot.AlignedData {
  return history.columns();
}

/** The range of the scale in steps of 250, so that it does not change with every movement. */
export function roomRound(...included: (number | null)[]): [number, number] {
  const values = included.filter((value) => value !== null);
  if (values.length === 0) return [0, 2000];
  const least = Math.floor(Math.min(...values) / 250) * 250;
  return [least, Math.max(Math.ceil(Math.max(...values) / 250) * 250, least + 250)];
}
