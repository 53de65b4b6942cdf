/** A short tone when an urgent Alert is raised: off unless this device has switched it on, made without a file. */
import { useEffect, useRef, useSyncExternalStore } from "react";
import { useFamily, useLive } from "~/live/hooks";
import { isUrgent } from "./attention";

const STORAGE_KEY = "handover.sound";
/** However many Alerts come, one tone in so many ms. */
const MIN_PAUSE_MS = 5000;
const TONE_S = 0.18;

const listeners = new Set<() => void>();
let context: AudioContext | null = null;

export function isSoundOn(): boolean {
  return localStorage.getItem(STORAGE_KEY) === "on";
}

export function useSound(): boolean {
  return useSyncExternalStore((listener) => {
    listeners.add(listener);
    return () => listeners.delete(listener);
  }, isSoundOn);
}

/** Switch the sound on (with one tone as a sample) or off. */
export function setSound(on: boolean): void {
  localStorage.setItem(STORAGE_KEY, on ? "on" : "off");
  for (const listener of listeners) listener();
  if (on) playTone();
}

/** Two tones, the second higher. A browser that waits for a first touch or key stays silent until then. */
export function playTone(): void {
  context ??= new AudioContext();
  const audio = context;
  void audio.resume().then(() => {
    for (const [nth, hertz] of [660, 880].entries()) {
      const oscillator = audio.createOscillator();
      const volume = audio.createGain();
      const from = audio.currentTime + nth * TONE_S;
      oscillator.frequency.value = hertz;
      volume.gain.setValueAtTime(0.0001, from);
      volume.gain.exponentialRampToValueAtTime(0.3, from + 0.02);
      volume.gain.exponentialRampToValueAtTime(0.0001, from + TONE_S);
      oscillator.connect(volume).connect(audio.destination);
      oscillator.start(from);
      oscillator.stop(from + TONE_S);
    }
  });
}

/** Play a tone when an urgent Alert comes that was not there before. */
export function useAlertSound(): void {
  const alerts = useFamily("alert");
  const live = useLive();
  const known = useRef<Set<string> | null>(null);
  const playedAt = useRef(-Infinity);
  useEffect(() => {
    if (!live.hasSnapshot) return;
    const urgent = new Set(alerts.filter(isUrgent).map((alert) => `${alert.id} ${alert.dateIssued}`));
    const before = known.current;
    known.current = urgent;
    // What was there when the page was opened is no news.
    if (before === null || !isSoundOn() || [...urgent].every((one) => before.has(one))) return;
    const now = performance.now();
    if (now - playedAt.current < MIN_PAUSE_MS) return;
    playedAt.current = now;
    playTone();
  }, [alerts, live]);
}
