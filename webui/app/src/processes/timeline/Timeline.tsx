/** Timeline: real time from left to right, a lane for each performer, a bar for each Task. */
import { ZoomIn, ZoomOut } from "lucide-react";
import { memo, useEffect, useRef, useState } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { duration } from "~/design/times";
import { localizedText } from "~/i18n/server";
import { useNow } from "~/live/clock";
import type { ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import { nameOf, taskMark } from "../names";
import { markFormat, marksOf, percentAt, spanOf, stepFor, type Span } from "./axis";
import { lanesOf, type Bar } from "./lanes";
import "./Timeline.css";

/** More bars than this are no picture any more; the table and the export have all. */
const MAX_BARS = 400;
const MAX_ZOOM = 64;
const MARK_PX = 110;
/** The width of the performers' names; the style has the same value. */
const NAMES_PX = 112;

export interface TimelineProps {
  process: ProcessView;
  tasks: readonly TaskView[];
  picked: string;
  onPick: (task: string) => void;
}

export function Timeline({ process, tasks, picked, onPick }: TimelineProps) {
  const { t } = useTranslation("processes");
  const clock = useNow();
  // The clock ticks once a second, and a Task may have come since; another machine's clock may be ahead, too.
  const now = tasks.reduce((latest, task) => Math.max(latest, Date.parse(task.createdAt)), clock);
  const [zoom, setZoom] = useState(1);
  const { ref, width } = useWidth();
  const zoomTo = (next: number) => {
    const place = ref.current;
    setZoom(next);
    if (place === null) return;
    // What was in the middle stays there.
    const middle = (place.scrollLeft + place.clientWidth / 2) / zoom;
    requestAnimationFrame(() => place.scrollTo({ left: middle * next - place.clientWidth / 2 }));
  };
  const shown = tasks.slice(-MAX_BARS);
  const lanes = lanesOf(shown, now);
  const begin = shown.length < tasks.length ? (lanes[0]?.bars[0]?.course.fromMs ?? 0) : Date.parse(process.startedAt);
  const end = lanes.flatMap((lane) => lane.bars).reduce((last, bar) => Math.max(last, bar.course.toMs), begin);
  const running = process.endedAt === null;
  const span = spanOf(begin, running ? Math.max(end, now) : Math.max(end, Date.parse(process.endedAt ?? "")), running);
  return (
    <div className="timeline">
      <div className="timeline__scroll" ref={ref} tabIndex={0} role="region" aria-label={t("timeline.label")}>
        <div className="timeline__content" style={{ width: `${zoom * 100}%` }}>
          <Axis span={span} most={Math.max(2, Math.floor(((width - NAMES_PX) * zoom) / MARK_PX))} />
          {lanes.map((lane) => (
            <div className="timeline__lane" key={lane.performer} role="group" aria-label={lane.performer}>
              <div className="timeline__performer">{lane.performer === "" ? t("task.nobody") : lane.performer}</div>
              <div className="timeline__bars" style={{ height: `${lane.rows * 30 + 6}px` }}>
                {lane.bars.map((bar) => (
                  <BarButton key={bar.task.id} bar={bar} span={span} picked={taskMark(bar.task) === picked} onPick={onPick} />
                ))}
              </div>
            </div>
          ))}
          {running && (
            <div className="timeline__over" aria-hidden>
              <div className="timeline__now" style={{ left: `${percentAt(span, now)}%` }} />
            </div>
          )}
        </div>
      </div>
      <div className="timeline__footer small quiet">
        <span className="timeline__key">
          <i className="timeline__sample timeline__stretch--pending" aria-hidden /> {t("timeline.waits")}
          <i className="timeline__sample timeline__stretch--inProgress" aria-hidden /> {t("timeline.works")}
          <i className="timeline__sample timeline__sample--completed" aria-hidden /> {t("timeline.done")}
          <i className="timeline__sample timeline__sample--failed" aria-hidden /> {t("timeline.failed")}
        </span>
        {shown.length < tasks.length && <span>{t("timeline.onlyLast", { count: shown.length })}</span>}
        <span role="group" aria-label={t("timeline.zoom")} className="timeline__zoom">
          <Button kind="quiet" label={t("timeline.further")} isDisabled={zoom === 1} icon={<ZoomOut aria-hidden size={18} />} onPress={() => zoomTo(Math.max(1, zoom / 2))} />
          <Button kind="quiet" label={t("timeline.closer")} isDisabled={zoom === MAX_ZOOM} icon={<ZoomIn aria-hidden size={18} />} onPress={() => zoomTo(Math.min(MAX_ZOOM, zoom * 2))} />
        </span>
      </div>
    </div>
  );
}

function Axis({ span, most }: { span: Span; most: number }) {
  const { i18n } = useTranslation();
  const format = new Intl.DateTimeFormat(i18n.language, markFormat(stepFor(span.toMs - span.fromMs, most)));
  return (
    <div className="timeline__axis" aria-hidden>
      {marksOf(span, most, new Date(span.fromMs).getTimezoneOffset()).map((mark) => (
        <div key={mark} className="timeline__mark" style={{ left: `${percentAt(span, mark)}%` }}>
          <span>{format.format(mark)}</span>
        </div>
      ))}
    </div>
  );
}

interface BarProps {
  bar: Bar;
  span: Span;
  picked: boolean;
  onPick: (task: string) => void;
}

const BarButton = memo(
  function BarButton({ bar, span, picked, onPick }: BarProps) {
    const { t, i18n } = useTranslation(["processes", "common"]);
    const { task, course } = bar;
    const left = percentAt(span, course.fromMs);
    const width = percentAt(span, course.toMs) - left;
    const length = Math.max(1, course.toMs - course.fromMs);
    const took = duration(course.ended ? length : Math.floor(length / 1000) * 1000, i18n.language);
    const name = nameOf(task);
    const label = [name, t(`common:status.${task.status}`), took, localizedText(task, "reason")].filter((part) => part !== null).join(", ");
    return (
      <button
        type="button"
        className={`timeline__bar timeline__bar--${task.status}`}
        style={{ left: `${left}%`, width: `max(10px, ${width}%)`, top: `${bar.row * 30 + 4}px` }}
        aria-pressed={picked}
        aria-label={label}
        title={label}
        onClick={() => onPick(picked ? "" : taskMark(task))}
      >
        {course.stretches.map((stretch) => (
          <i
            key={stretch.fromMs}
            className={`timeline__stretch timeline__stretch--${stretch.status}`}
            style={{ width: `${((stretch.toMs - stretch.fromMs) / length) * 100}%` }}
          />
        ))}
        <span className="timeline__name">{task.status === "failed" ? `✕ ${name}` : name}</span>
      </button>
    );
  },
  (before, after) =>
    before.picked === after.picked &&
    before.onPick === after.onPick &&
    before.span.fromMs === after.span.fromMs &&
    before.span.toMs === after.span.toMs &&
    before.bar.row === after.bar.row &&
    before.bar.task.status === after.bar.task.status &&
    before.bar.task.name === after.bar.task.name &&
    before.bar.course.toMs === after.bar.course.toMs &&
    before.bar.course.stretches.length === after.bar.course.stretches.length,
);

function useWidth() {
  const ref = useRef<HTMLDivElement>(null);
  const [width, setWidth] = useState(800);
  useEffect(() => {
    const place = ref.current;
    if (place === null) return;
    const sizes = new ResizeObserver(() => setWidth(place.clientWidth));
    sizes.observe(place);
    return () => sizes.disconnect();
  }, []);
  return { ref, width };
}
