/** The treadmill trainer: what a training is, and what was said in it. */
import type { MachineView } from "~/api/generated/assistive-devices";

export const ADVICE = ["faster", "keep", "slower"] as const;
export const INTENSITIES = ["gentle", "light", "moderate", "brisk"] as const;
export type Advice = (typeof ADVICE)[number];
export type Intensity = (typeof INTENSITIES)[number];

/** The zones of the service, to show them before a training begins. */
export const ZONES: Record<Intensity, { lowBpm: number; highBpm: number }> = {
  gentle: { lowBpm: 75, highBpm: 85 },
  light: { lowBpm: 85, highBpm: 95 },
  moderate: { lowBpm: 95, highBpm: 105 },
  brisk: { lowBpm: 105, highBpm: 115 },
};

export interface Intervention {
  number: number;
  at: string;
  advice: Advice;
  source: "template" | "model" | null;
  text?: string;
}

export interface Trainer {
  durationS: number;
  timeLeftS: number;
  intensity: Intensity;
  language: string;
  consentsToModel: boolean;
  hasModel: boolean;
  zone: { lowBpm: number; highBpm: number };
  interventions: Intervention[];
}

/** Return the trainer of a machine; null for other machines. */
export function trainerOf({ details }: Pick<MachineView, "details">): Trainer | null {
  const trainer = details["trainer"];
  return typeof trainer === "object" && trainer !== null ? (trainer as Trainer) : null;
}

/** Return minutes and seconds, such as 9:05. */
export function minutesText(seconds: number): string {
  const whole = Math.max(0, Math.ceil(seconds));
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

/** Return what is to be spoken: the newest words, unless they were there when the page came. */
export function newWords(interventions: readonly Intervention[], lastAt: string | null): Intervention | null {
  const newest = interventions.at(-1);
  return newest?.text === undefined || lastAt === null || newest.at <= lastAt ? null : newest;
}

/** The language of a text: a template is in that of the page, a model was asked for that of the training. */
export function languageOf({ source }: Pick<Intervention, "source">, trainer: Pick<Trainer, "language">, page: string): string {
  return source === "model" ? trainer.language : page;
}
