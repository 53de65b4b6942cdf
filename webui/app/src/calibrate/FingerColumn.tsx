/** A finger: the present value and state, and its two thresholds. */
import { Minus, Plus } from "lucide-react";
import { useId, useState } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { number, typedNumber } from "~/design/numbers";
import { fingers } from "~/hand/geometry";
import { useTopicSelector } from "~/live/hooks";
import type { Finger } from "~/live/messages";
import { bounds, stateUnder, type Bound, type Thresholds } from "./draft";

interface FingerColumnProps {
  glove: string;
  finger: Finger;
  isChosen: boolean;
  /** The thresholds that differ from the saved ones. */
  saved: Thresholds[Finger];
  thresholds: Thresholds[Finger];
  step: number;
  top: number;
  onChoose: () => void;
  onMove: (bound: Bound, to: number) => void;
}

export function FingerColumn({ glove, finger, isChosen, saved, thresholds, step, top, onChoose, onMove }: FingerColumnProps) {
  const { t } = useTranslation(["calibrate", "hand"]);
  const name = t(`hand:finger.${finger}`);
  return (
    <section className="calibrate__finger" data-chosen={isChosen || undefined} aria-label={name}>
      <button type="button" className="calibrate__choose" aria-pressed={isChosen} onClick={onChoose}>
        <span className="calibrate__swatch" style={{ background: `var(--finger-${fingers.indexOf(finger)})` }} aria-hidden />
        {name}
      </button>
      <Gauge glove={glove} finger={finger} thresholds={thresholds} top={top} />
      {bounds.map((bound) => (
        <Stepper
          key={bound}
          name={t("of", { bound: t(`bound.${bound}`), finger: name })}
          label={t(`bound.${bound}`)}
          value={thresholds[bound]}
          isChanged={thresholds[bound] !== saved[bound]}
          step={step}
          onMove={(to) => onMove(bound, to)}
        />
      ))}
    </section>
  );
}

function Gauge({ glove, finger, thresholds, top }: { glove: string; finger: Finger; thresholds: Thresholds[Finger]; top: number }) {
  const { t, i18n } = useTranslation(["calibrate", "hand"]);
  const place = fingers.indexOf(finger);
  const bend = useTopicSelector(`glove/${glove}`, (view) => view?.bend?.[place] ?? null);
  const share = (value: number) => `${Math.min(Math.max(value / top, 0), 1) * 100}%`;
  const state = bend === null ? null : stateUnder(thresholds, bend);
  const [above, below] = thresholds.inverted ? ["bent", "straight"] : ["straight", "bent"];
  return (
    <div className="calibrate__now">
      <div className="calibrate__gauge" aria-hidden>
        <span className={`calibrate__zone calibrate__zone--above calibrate__zone--${above}`} style={{ bottom: share(thresholds.upper), top: 0 }} />
        <span className={`calibrate__zone calibrate__zone--below calibrate__zone--${below}`} style={{ bottom: 0, height: share(thresholds.lower) }} />
        {bend !== null && <span className="calibrate__level" style={{ bottom: share(bend), background: `var(--finger-${place})` }} />}
      </div>
      <p className="calibrate__says">
        <strong>{state === null ? t("unseen") : t(`state.${state}`)}</strong>
        <span className="quiet">{bend === null ? "–" : number(Math.round(bend), i18n.language)}</span>
      </p>
    </div>
  );
}

interface StepperProps {
  name: string;
  label: string;
  value: number;
  isChanged: boolean;
  step: number;
  onMove: (to: number) => void;
}

function Stepper({ name, label, value, isChanged, step, onMove }: StepperProps) {
  const { t, i18n } = useTranslation("calibrate");
  const id = useId();
  /** The text being typed; it is applied when the field loses the focus. */
  const [typed, setTyped] = useState<string | null>(null);
  const commit = () => {
    const to = typedNumber(typed ?? "", i18n.language);
    if (to !== null) onMove(to);
    setTyped(null);
  };
  const move = (by: number) => {
    setTyped(null);
    onMove(value + by);
  };
  return (
    <div className="calibrate__stepper" data-changed={isChanged || undefined}>
      <label htmlFor={id}>{label}</label>
      <div className="calibrate__steps">
        <Button kind="plain" label={t("down", { name, step })} icon={<Minus aria-hidden size={18} />} onPress={() => move(-step)} />
        <input
          id={id}
          aria-label={name}
          inputMode="numeric"
          value={typed ?? number(value, i18n.language)}
          onChange={(event) => setTyped(event.target.value)}
          onBlur={commit}
          onKeyDown={(event) => {
            if (event.key === "Enter") commit();
            else if (event.key === "ArrowUp") move(step);
            else if (event.key === "ArrowDown") move(-step);
          }}
        />
        <Button kind="plain" label={t("up", { name, step })} icon={<Plus aria-hidden size={18} />} onPress={() => move(step)} />
      </div>
    </div>
  );
}
