/** A slider with its value as text. */
import { useId } from "react";

export interface SliderProps {
  label: string;
  value: number;
  min: number;
  max: number;
  step: number;
  text: string;
  /** Texts below both ends. */
  ends?: readonly [string, string];
  onChange: (value: number) => void;
}

export function Slider({ label, value, min, max, step, text, ends, onChange }: SliderProps) {
  const id = useId();
  return (
    <div className="slider">
      <label htmlFor={id}>{label}</label>
      <output htmlFor={id}>{text}</output>
      <input id={id} type="range" value={value} min={min} max={max} step={step} aria-valuetext={text} onChange={(event) => onChange(event.target.valueAsNumber)} />
      {ends?.map((end) => (
        <span key={end} className="slider__end quiet">
          {end}
        </span>
      ))}
    </div>
  );
}
