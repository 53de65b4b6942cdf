/** Diagram: a BPMN file with marks, to be moved and zoomed with mouse, touch and keyboard. */
import "bpmn-js/dist/assets/diagram-js.css";
import "bpmn-js/dist/assets/bpmn-js.css";
import { Maximize, ZoomIn, ZoomOut } from "lucide-react";
import { useEffect, useRef, useState, type KeyboardEvent } from "react";
import { useTranslation } from "react-i18next";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Drawing } from "./drawing";
import { drawn } from "./layout";
import type { Marks } from "./marks";
import "./Diagram.css";
import "./heat.css";

export interface DiagramProps {
  xml: string;
  label: string;
  marks: Marks;
  /** An element that comes to the middle; another `at` brings the same one there again. */
  centred?: { element: string; at: number } | null;
  onPick?: (element: string | null) => void;
}

const STEP = 60;
const ZOOM = 1.25;

export default function Diagram({ xml, label, marks, centred = null, onPick }: DiagramProps) {
  const { t } = useTranslation("processes");
  const place = useRef<HTMLDivElement>(null);
  const drawing = useRef<Drawing | null>(null);
  const pick = useRef(onPick);
  const [state, setState] = useState<{ xml: string; laidOut: boolean; failure: string | null } | null>(null);
  const ready = state?.xml === xml && state.failure === null;

  useEffect(() => {
    pick.current = onPick;
  });

  useEffect(() => {
    const container = place.current;
    if (container === null) return;
    let left = false;
    const made = new Drawing(container, (element) => pick.current?.(element));
    drawing.current = made;
    const sizes = new ResizeObserver(() => made.resized());
    sizes.observe(container);
    drawn(xml)
      .then(async (file) => {
        if (left) return;
        await made.show(file.xml);
        setState({ xml, laidOut: file.laidOut, failure: null });
      })
      .catch((error: unknown) => {
        if (!left) setState({ xml, laidOut: false, failure: errorText(error) });
      });
    return () => {
      left = true;
      sizes.disconnect();
      drawing.current = null;
      made.destroy();
    };
  }, [xml]);

  useEffect(() => {
    if (ready) drawing.current?.mark(marks);
  }, [ready, marks]);

  useEffect(() => {
    if (ready && centred !== null) drawing.current?.centre(centred.element);
  }, [ready, centred]);

  const move = (event: KeyboardEvent) => {
    const act = moves[event.key];
    if (act === undefined || drawing.current === null || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation();
    act(drawing.current);
  };

  return (
    <figure className="diagram" data-noted={(ready && state.laidOut) || undefined}>
      {state?.xml === xml && state.failure !== null ? (
        <ErrorMessage>{t("diagram.unreadable", { why: state.failure })}</ErrorMessage>
      ) : null}
      {/* A drawing is moved with the arrow keys, as its label says; there is no native element that does so. */}
      <div
        ref={place}
        className="diagram__place"
        tabIndex={0}
        role="application"
        aria-label={label}
        aria-description={t("diagram.keys")}
        onKeyDown={move}
      />
      <div className="diagram__plate" aria-hidden />
      {ready && state.laidOut && <figcaption className="diagram__note">{t("diagram.laidOut")}</figcaption>}
      <div className="diagram__zoom" role="group" aria-label={t("diagram.zoom")}>
        <Button label={t("diagram.closer")} icon={<ZoomIn aria-hidden size={18} />} onPress={() => drawing.current?.zoomBy(ZOOM)} />
        <Button label={t("diagram.further")} icon={<ZoomOut aria-hidden size={18} />} onPress={() => drawing.current?.zoomBy(1 / ZOOM)} />
        <Button label={t("diagram.fit")} icon={<Maximize aria-hidden size={18} />} onPress={() => drawing.current?.fit()} />
      </div>
    </figure>
  );
}

const moves: Partial<Record<string, (drawing: Drawing) => void>> = {
  ArrowLeft: (drawing) => drawing.pan(STEP, 0),
  ArrowRight: (drawing) => drawing.pan(-STEP, 0),
  ArrowUp: (drawing) => drawing.pan(0, STEP),
  ArrowDown: (drawing) => drawing.pan(0, -STEP),
  "+": (drawing) => drawing.zoomBy(ZOOM),
  "-": (drawing) => drawing.zoomBy(1 / ZOOM),
  "0": (drawing) => drawing.fit(),
};
