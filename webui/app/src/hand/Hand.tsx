/** A drawing of a hand: for requested gestures and for the live hand in the glove. */
import type { CSSProperties } from "react";
import { useTranslation } from "react-i18next";
import type { Finger } from "~/live/messages";
import { bendsOf, box, fingers, frameOf, type Side } from "./geometry";
import { HandShape } from "./HandShape";
import { useEased } from "./useEased";
import "./Hand.css";

export interface HandProps {
  /** Five finger states, thumb first: 0 straight, 1 between, 2 bent. */
  states: string;
  side?: Side;
  /** The initial states, from which the hand moves to `states` once. */
  animateFrom?: string;
  /** How long a change takes. */
  moveMs?: number;
  /** The height, as CSS has it; the width follows. */
  size?: string;
  /** Draw the hand as large as it fits, instead of every hand at the same scale. */
  closeUp?: boolean;
  /** The states whose close-up is the frame, so that this hand lies over that one at the same scale. */
  frameBy?: string;
  /** Fingers to highlight. */
  differs?: readonly Finger[];
  /** The name, "Thumbs up"; by default a list of the finger states. */
  label?: string;
}

const noFingers: readonly Finger[] = [];

export function Hand({ states, side = "right", animateFrom, moveMs = 450, size, closeUp = false, frameBy = states, differs = noFingers, label }: HandProps) {
  const description = useFingers(states);
  const bends = useEased(bendsOf(states), moveMs, animateFrom === undefined ? undefined : bendsOf(animateFrom));
  const frame = closeUp ? frameOf(bendsOf(frameBy)) : { x: 0, y: 0, ...box };
  const left = side === "left" ? box.width - frame.x - frame.width : frame.x;
  const style: CSSProperties | undefined = size === undefined ? undefined : { height: size };
  return (
    <svg
      className="hand"
      viewBox={[left, frame.y, frame.width, frame.height].map((part) => Math.round(part * 10) / 10).join(" ")}
      role="img"
      aria-label={label === undefined ? description : `${label}: ${description}`}
      {...(style === undefined ? {} : { style })}
    >
      <g {...(side === "left" ? { transform: `translate(${box.width} 0) scale(-1 1)` } : {})}>
        <HandShape bends={bends} differs={differs} />
      </g>
    </svg>
  );
}

/** The states in words: "thumb straight, index finger bent, …". */
export function useFingers(states: string): string {
  const { t } = useTranslation("hand");
  return fingers
    .map((finger, index) => t(`fingerState.${states[index] ?? "0"}`, { finger: t(`finger.${finger}`) }))
    .join(", ");
}

/** The name of a gesture in the language of the page; gestures added by the site keep their names. */
export function useGestureName(): (gesture: string) => string {
  const { t, i18n } = useTranslation("hand");
  return (gesture) => (i18n.exists(`hand:gesture.${gesture}`) ? t(`gesture.${gesture}`) : gesture);
}
