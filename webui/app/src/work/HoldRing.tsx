/**
* The ring around the hand: grey while nothing counts, filling while the right gesture is held. It is drawn
* from the messages of the controller and, between two messages, by the clock of the page, at most
* a short time ahead.
 */
import { useEffect, useRef } from "react";
import type { GloveView } from "~/live/messages";
import { ringPart } from "./ring";
import "./HoldRing.css";

const RADIUS = 47;
const ROUND = 2 * Math.PI * RADIUS;

export interface HoldRingProps {
  hold: GloveView["hold"];
  /** The held gesture is the requested one. */
  right: boolean;
  /** The gesture was confirmed: the ring is closed. */
  closed?: boolean;
}

export function HoldRing({ hold, right, closed = false }: HoldRingProps) {
  const arc = useRef<SVGCircleElement>(null);
  const { heldMs, announceMs, confirmMs } = hold;
  useEffect(() => {
    const receivedMs = performance.now();
    let frame = 0;
    const draw = (nowMs: number) => {
      const part = closed ? 1 : right ? ringPart({ heldMs, announceMs, confirmMs }, nowMs - receivedMs) : 0;
      arc.current?.setAttribute("stroke-dashoffset", String(ROUND * (1 - part)));
      arc.current?.setAttribute("visibility", part > 0 ? "visible" : "hidden");
      if (right && !closed && heldMs > 0 && part < 1) frame = requestAnimationFrame(draw);
    };
    draw(receivedMs);
    return () => cancelAnimationFrame(frame);
  }, [heldMs, announceMs, confirmMs, right, closed]);
  return (
    <svg className={closed ? "hold-ring hold-ring--closed" : "hold-ring"} viewBox="0 0 100 100" aria-hidden>
      <circle className="hold-ring__way" cx="50" cy="50" r={RADIUS} />
      <circle
        ref={arc}
        className="hold-ring__arc"
        cx="50"
        cy="50"
        r={RADIUS}
        transform="rotate(-90 50 50)"
        strokeDasharray={ROUND}
        strokeDashoffset={ROUND}
        visibility="hidden"
      />
    </svg>
  );
}
