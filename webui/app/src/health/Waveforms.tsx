/** The waveforms of the last seconds. Each is drawn with the frames of the screen, only while it is seen and new. */
import { Activity, TimerOff } from "lucide-react";
import { useEffect, useRef } from "react";
import { useTranslation } from "react-i18next";
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { Card } from "~/design/Card";
import { EmptyState } from "~/design/EmptyState";
import { number as inWords } from "~/design/numbers";
import { StatusBadge } from "~/design/StatusBadge";
import { spaced } from "~/devices/values";
import { useNow } from "~/live/clock";
import { useShownTheme } from "~/shell/theme";
import { symbolOf } from "./health";
import type { LiveSignals } from "./liveSignals";
import { keyOf, WAVE_S, type WaveBuffer } from "./waveform";

/** The newest packet is drawn so much later that the line moves evenly between packets. */
const DELAY_S = 0.5;
const SILENT_MS = 3000;
const COLOURS = ["--accent", "--attention", "--ok", "--stop"];
const DASHES = [[], [6, 3], [2, 3], [10, 3, 2, 3]];

export function Waveforms({ signals, waves }: { signals: LiveSignals; waves: readonly WaveBuffer[] }) {
  const { t } = useTranslation("health");
  return (
    <Card title={t("waves.title")} className="health__waves">
      {waves.length === 0 ? <EmptyState icon={<Activity aria-hidden size={32} />} title={t("waves.none")} /> : waves.map((wave) => <Waveform key={keyOf(wave)} wave={wave} signals={signals} />)}
    </Card>
  );
}

function Waveform({ wave, signals }: { wave: WaveBuffer; signals: LiveSignals }) {
  const { t, i18n } = useTranslation("health");
  const place = useRef<HTMLDivElement>(null);
  const theme = useShownTheme();
  const isSilent = useNow() - wave.receivedMs > SILENT_MS;

  useEffect(() => {
    const host = place.current;
    if (host === null) return;
    const plot = new uPlot(optionsOf(host, wave, i18n.language), wave.columns(), host);
    let frame = 0;
    let isSeen = true;
    let shownS = -Infinity;
    const draw = () => {
      frame = 0;
      const sinceS = (Date.now() - wave.receivedMs) / 1000;
      // It never runs ahead of the signal, and never back.
      const endS = Math.min(wave.endS, wave.endS + sinceS - DELAY_S);
      shownS = endS > shownS || shownS - endS > DELAY_S * 4 ? endS : shownS;
      plot.batch(() => {
        plot.setData(wave.columns(), false);
        plot.setScale("x", { min: shownS - WAVE_S, max: shownS });
      });
      if (sinceS < SILENT_MS / 1000) drawSoon();
    };
    const drawSoon = () => {
      if (frame === 0 && isSeen && !document.hidden) frame = requestAnimationFrame(draw);
    };
    const forget = signals.onPackets(drawSoon);
    const visibility = new IntersectionObserver(([entry]) => {
      isSeen = entry?.isIntersecting ?? true;
      drawSoon();
    });
    visibility.observe(host);
    const resized = new ResizeObserver(() => plot.setSize({ width: host.clientWidth, height: host.clientHeight }));
    resized.observe(host);
    drawSoon();
    return () => {
      cancelAnimationFrame(frame);
      forget();
      visibility.disconnect();
      resized.disconnect();
      plot.destroy();
    };
  }, [wave, signals, theme, i18n.language]);

  const name = t(`signal.${wave.kind}`, { defaultValue: spaced(wave.kind) });
  const symbol = symbolOf(wave.kind, wave.unit);
  return (
    <section className="waveform" data-silent={isSilent || undefined} aria-label={`${name}, ${wave.sensor}`}>
      <header className="waveform__head">
        <h3>
          {name} {symbol !== "" && <span className="quiet">({symbol})</span>}
        </h3>
        <span className="quiet small">{wave.sensor}</span>
        {wave.channels.length > 1 && (
          <ul className="waveform__channels small">
            {wave.channels.slice(0, COLOURS.length).map((channel, index) => (
              <li key={channel} data-channel={index}>
                {channel}
              </li>
            ))}
          </ul>
        )}
        {isSilent && (
          <StatusBadge tone="attention" icon={<TimerOff aria-hidden size="1.15em" />}>
            {t("waves.silent")}
          </StatusBadge>
        )}
      </header>
      <div ref={place} className="waveform__plot" role="img" aria-label={t("waves.label", { name, seconds: WAVE_S })} />
    </section>
  );
}

function optionsOf(host: HTMLElement, wave: WaveBuffer, language: string): uPlot.Options {
  const style = getComputedStyle(host);
  const colour = (name: string) => style.getPropertyValue(name).trim();
  const axis = { stroke: colour("--text-quiet"), font: `12px ${style.fontFamily}`, grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false } };
  return {
    width: host.clientWidth,
    height: host.clientHeight,
    legend: { show: false },
    cursor: { show: false },
    scales: { x: { time: false } },
    axes: [
      {
        ...axis,
        size: 28,
        splits: (_, __, min, max) => [max - WAVE_S, max - WAVE_S / 2, max].filter((at) => at >= min),
        values: (_, splits) => splits.map((at) => `${Math.round(at - (splits.at(-1) ?? at))} s`),
      },
      { ...axis, size: 56, values: (_, splits) => splits.map((value) => inWords(value, language)) },
    ],
    series: [
      {},
      ...wave.channels.map((label, index) => ({
        label,
        stroke: colour(COLOURS[index % COLOURS.length] ?? "--accent"),
        dash: DASHES[index % DASHES.length] ?? [],
        width: 1.5,
        points: { show: false },
        spanGaps: false,
      })),
    ],
  };
}
