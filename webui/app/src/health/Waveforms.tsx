/**
 * The waveforms of the last seconds. Each moves with the frames of the screen, only while it is seen and new.
 *
 * A plot is drawn a little wider than it is shown, a few times a second; between that the compositor moves it, which
 * takes half of the work of drawing each frame. So its labels are beside it, not in it.
 */
import { Activity, TimerOff } from "lucide-react";
import { useEffect, useRef } from "react";
import { useTranslation } from "react-i18next";
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { Card } from "~/design/Card";
import { EmptyState } from "~/design/EmptyState";
import { FrameScheduler } from "~/design/frameScheduler";
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
/** The plot is drawn so much further than it is shown. */
const AHEAD_S = 0.25;
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
    const labels = document.createElement("div");
    labels.className = "waveform__labels";
    const pane = document.createElement("div");
    pane.className = "waveform__pane";
    host.append(labels, pane);
    let splits: number[] = [];
    const plot = new uPlot(
      optionsOf(pane, wave, (found) => {
        splits = found;
      }),
      wave.columns(),
      pane,
    );
    const heightOf = (value: number) => plot.valToPos(value, "y") + plot.over.offsetTop;
    let shownS = -Infinity;
    let drawnS = -Infinity;
    let knownS = -Infinity;
    const redraw = () => {
      [drawnS, knownS] = [shownS, wave.endS];
      plot.batch(() => {
        plot.setData(wave.columns(), false);
        plot.setScale("x", { min: shownS - WAVE_S, max: shownS + AHEAD_S });
      });
      label(labels, splits, heightOf, i18n.language);
    };
    const frames = new FrameScheduler(host, () => {
      const sinceS = (Date.now() - wave.receivedMs) / 1000;
      // It never runs ahead of the signal, and never back.
      const endS = Math.min(wave.endS, wave.endS + sinceS - DELAY_S);
      shownS = endS > shownS || shownS - endS > DELAY_S * 4 ? endS : shownS;
      // Again when what was drawn ahead is shown, or has become known only now, and after a signal began again.
      if (shownS > drawnS + AHEAD_S || shownS < drawnS || (shownS > knownS && wave.endS > knownS)) redraw();
      const moved = Number.isFinite(shownS) ? (-(shownS - drawnS) / WAVE_S) * pane.clientWidth : 0;
      plot.root.style.transform = `translateX(${moved.toFixed(2)}px)`;
      return sinceS < SILENT_MS / 1000;
    });
    const forget = signals.onPackets(frames.request);
    const resized = new ResizeObserver(() => {
      plot.setSize(sizeOf(pane));
      label(labels, splits, heightOf, i18n.language);
    });
    resized.observe(pane);
    frames.request();
    return () => {
      frames.dispose();
      forget();
      resized.disconnect();
      plot.destroy();
      host.replaceChildren();
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
      <div className="waveform__times small quiet" aria-hidden>
        {[-WAVE_S, -WAVE_S / 2, 0].map((at) => (
          <span key={at}>{at} s</span>
        ))}
      </div>
    </section>
  );
}

/** The size of a plot: that of its pane, and what is drawn ahead. */
function sizeOf(pane: HTMLElement): { width: number; height: number } {
  return { width: Math.max(1, Math.round(pane.clientWidth * (1 + AHEAD_S / WAVE_S))), height: Math.max(1, pane.clientHeight) };
}

/** Write the numbers of an axis at their heights; what has not changed is left alone. */
function label(host: HTMLElement, splits: readonly number[], heightOf: (value: number) => number, language: string): void {
  while (host.children.length > splits.length) host.lastElementChild?.remove();
  splits.forEach((value, index) => {
    const each = host.children.item(index) ?? host.appendChild(document.createElement("span"));
    const [text, top] = [inWords(value, language), `${Math.round(heightOf(value))}px`];
    if (each.textContent !== text) each.textContent = text;
    if (each instanceof HTMLElement && each.style.top !== top) each.style.top = top;
  });
}

function optionsOf(pane: HTMLElement, wave: WaveBuffer, onSplits: (splits: number[]) => void): uPlot.Options {
  const style = getComputedStyle(pane);
  const colour = (name: string) => style.getPropertyValue(name).trim();
  return {
    ...sizeOf(pane),
    padding: [6, 0, 6, 0],
    legend: { show: false },
    cursor: { show: false },
    scales: { x: { time: false } },
    axes: [
      { show: false },
      {
        size: 0,
        grid: { stroke: colour("--line"), width: 1 },
        ticks: { show: false },
        values: (_, splits) => {
          onSplits(splits);
          return splits.map(() => "");
        },
      },
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
