/** What holds the humanoid or slows it down, in the words of the page, and whether a person has to start it again. */
import i18next from "i18next";
import { percent } from "~/design/numbers";
import { reasonOf } from "~/health/health";
import { localizedText } from "~/i18n/server";
import type { LiveDocument } from "./humanoid";

/** Faults first, then the stop, the limit, and a control that must be released. */
export function holdersOf({ fault, stop, limit, needsRelease }: LiveDocument): string[] {
  const found: string[] = [];
  if (fault !== null) found.push(sentence(localizedText(fault, "message") ?? fault.message));
  if (stop.isStopped) found.push(i18next.t("humanoid:stop.stopped", { who: stop.by, reason: stop.reason }));
  if (limit.factor < 1 || limit.needsReset) found.push(limitText(limit));
  if (needsRelease) found.push(i18next.t("humanoid:walk.release"));
  return found;
}

/** The cycle has ended, or its joints hold for good. */
export function needsRestart({ fault, mode }: LiveDocument): boolean {
  return fault?.code === "cycleEnded" || mode === "holding" || mode === "down";
}

/** A text of the service as it stands alone: messages begin with a small letter, since they may follow others. */
function sentence(text: string): string {
  return text.charAt(0).toLocaleUpperCase(i18next.language) + text.slice(1);
}

/** The limit of human state with its reason; the service names its own stop around that of human state. */
export function limitText(limit: LiveDocument["limit"]): string {
  const { key, seconds, text } = reasonOf({ reason: reasonOf(limit).text });
  const why = key === "other" ? (localizedText(limit, "reason") ?? text) : i18next.t(`health:limit.reason.${key}`, { seconds });
  const share = percent(limit.factor, i18next.language);
  return i18next.t(limit.factor <= 0 ? "humanoid:limit.stopped" : "humanoid:limit.slowed", { share, reason: why });
}
