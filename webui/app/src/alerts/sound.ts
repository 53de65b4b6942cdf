/** A short synthesized tone for urgent Alerts; off unless switched on for this device. */
import { useEffect, useRef, useSyncExternalStore } from "react";
import { useFamily, useLive } from "~/live/hooks";
import { isUrgent } from "./attention";

const STORAGE_KEY = "handover.sound";
/** At most one tone in this time, however many Alerts are raised. */
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

/** Play two tones, the second higher. Browsers are silent until the first touch or key press. */
export function playTone(): void {
  context ??= new AudioContext();
  const audio = context;
  void audio.resume().then(() => {
    for (const [index, hertz] of [660, 880].entries()) {
      const oscillator = audio.createOscillator();
      const volume = audio.createGain();
      const from = audio.currentTime + index * TONE_S;
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

/** Play a tone when a new urgent Alert is raised. */
export function useAlertSound(): void {
  const alerts = useFamily("alert");
  const live = useLive();
  const previous = useRef<Set<string> | null>(null);
  const playedAt = useRef(-Infinity);
  useEffect(() => {
    if (!live.hasSnapshot) return;
    const urgent = new Set(alerts.filter(isUrgent).map((alert) => `${alert.id} ${alert.dateIssued}`));
    const before = previous.current;
    previous.current = urgent;
    // Alerts from before the page was opened are not new.
    if (before === null || !isSoundOn() || [...urgent].every((alert) => before.has(alert))) return;
    const now = performance.now();
    if (now - playedAt.current < MIN_PAUSE_MS) return;
    playedAt.current = now;
    playTone();
  }, [alerts, live]);
}
