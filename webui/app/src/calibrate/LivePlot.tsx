/** The live signal of one minute: the chosen finger in front, its two thresholds as draggable lines. */
import { useCallback, useEffect, useRef, type PointerEvent } from "react";
import { useTranslation } from "react-i18next";
import type uPlot from "uplot";
import { number } from "~/design/numbers";
import { fingers } from "~/hand/geometry";
import type { Finger } from "~/live/messages";
import { bendOptions, roomRound, useBendPlot, type Look } from "~/plot/useBendPlot";
import { useShownTheme } from "~/shell/theme";
import { bounds, type Bound, type Thresholds } from "./draft";

const SECONDS = 60;
const [CHOSEN_PX, OTHERS_PX] = [3, 1];
/** The distance within which a pointer takes a line: wide, for fingers in gloves. */
const REACH_PX = 22;

interface LivePlotProps {
  glove: string;
  finger: Finger;
  thresholds: Thresholds;
  onDrag: (bound: Bound, to: number) => void;
}

export default function LivePlot({ glove, finger, thresholds, onDrag }: LivePlotProps) {
  const { t, i18n } = useTranslation("calibrate");
  const theme = useShownTheme();
  const drawnThresholds = useRef(thresholds[finger]);
  const dragged = useRef<Bound>(null);

  const look = useCallback<Look>(
    (host, seconds, now) => {
      const chosen = fingers.indexOf(finger);
      const options = bendOptions(host, seconds, now, i18n.language, (finger) => (finger === chosen ? CHOSEN_PX : OTHERS_PX));
      const style = getComputedStyle(host);
      const [line, ground] = [style.getPropertyValue("--text"), style.getPropertyValue("--surface")];
      const wordsOf = (bound: Bound) => `${t(`bound.${bound}`)} ${number(drawnThresholds.current[bound], i18n.language)}`;
      return {
        ...options,
        scales: {
          ...options.scales,
          y: { range: (_, least, most) => roomRound(least, most, drawnThresholds.current.lower, drawnThresholds.current.upper) },
        },
        hooks: { draw: [(plot) => bounds.forEach((bound) => drawLine(plot, bound, drawnThresholds.current[bound], wordsOf(bound), line, ground))] },
      };
    },
    // The plot reads the colours of the theme only when it is created.
    // eslint-disable-next-line react-hooks/exhaustive-deps -- create the plot again for a new theme
    [finger, i18n.language, t, theme],
  );
  const { place, plot } = useBendPlot(glove, SECONDS, look);

  useEffect(() => {
    drawnThresholds.current = thresholds[finger];
    plot.current?.redraw(true, true);
  }, [thresholds, finger, plot]);

  const heightOf = (event: PointerEvent) => event.clientY - (plot.current?.over.getBoundingClientRect().top ?? 0);
  const take = (event: PointerEvent<HTMLDivElement>) => {
    const drawn = plot.current;
    if (drawn === null) return;
    const distance = (bound: Bound) => Math.abs(drawn.valToPos(drawnThresholds.current[bound], "y") - heightOf(event));
    const nearest = distance("upper") <= distance("lower") ? "upper" : "lower";
    if (distance(nearest) > REACH_PX) return;
    dragged.current = nearest;
    event.currentTarget.setPointerCapture(event.pointerId);
    event.preventDefault();
  };
  const drag = (event: PointerEvent) => {
    if (dragged.current !== null && plot.current !== null) onDrag(dragged.current, plot.current.posToVal(heightOf(event), "y"));
  };
  const drop = () => {
    dragged.current = null;
  };

  return (
    <div
      ref={place}
      className="calibrate__plot"
      role="img"
      aria-label={t("plot", { finger: t(`hand:finger.${finger}`) })}
      onPointerDown={take}
      onPointerMove={drag}
      onPointerUp={drop}
      onPointerCancel={drop}
    />
  );
}

function drawLine(plot: uPlot, bound: Bound, at: number, words: string, line: string, ground: string): void {
  const { ctx, bbox } = plot;
  const scale = devicePixelRatio;
  const y = Math.round(plot.valToPos(at, "y", true));
  ctx.save();
  ctx.strokeStyle = line;
  ctx.lineWidth = 2 * scale;
  ctx.setLineDash(bound === "upper" ? [] : [8 * scale, 5 * scale]);
  ctx.beginPath();
  ctx.moveTo(bbox.left, y);
  ctx.lineTo(bbox.left + bbox.width, y);
  ctx.stroke();
  ctx.font = `600 ${13 * scale}px ${getComputedStyle(plot.root.parentElement ?? plot.root).fontFamily}`;
  const [width, room] = [ctx.measureText(words).width, 6 * scale];
  const below = bound === "lower" || y - 22 * scale < bbox.top;
  const top = below ? y + room / 2 : y - 22 * scale;
  ctx.fillStyle = ground;
  ctx.fillRect(bbox.left + room, top, width + 2 * room, 20 * scale);
  ctx.fillStyle = line;
  ctx.textAlign = "left";
  ctx.textBaseline = "middle";
  ctx.fillText(words, bbox.left + 2 * room, top + 10 * scale);
  ctx.restore();
}
