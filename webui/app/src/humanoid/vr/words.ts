/** What the panel in the scene says: instructions, score, and why a session is paused, in the language of the reader. */
import i18next from "i18next";
import { number } from "~/design/numbers";
import { holdersOf } from "../holders";
import type { LiveDocument } from "../humanoid";
import type { Outside } from "./bounds";
import type { PanelButton, PanelContent } from "./panel";

export type Act = "start" | "pause" | "resume" | "recentre" | "choose" | "leave";

export interface Situation {
  document: LiveDocument | null;
  /** The last document is too old to be shown as live. */
  isOld: boolean;
  isTracked: boolean;
  outside: Outside | null;
  isChoosing: boolean;
  mayChoose: boolean;
  mayExercise: boolean;
  failure: string | null;
}

export function panelContent(situation: Situation): PanelContent {
  const { document, isOld, isTracked, outside, failure, isChoosing } = situation;
  const t = i18next.getFixedT(null, "humanoidVr");
  const session = document?.session ?? null;
  const buttons = actsIn(situation).map((id): PanelButton => ({ id, label: t(`act.${id === "choose" && isChoosing ? "chosen" : id}`) }));
  const warn = (title: string, ...lines: string[]): PanelContent => ({ title, lines, isWarning: true, buttons });
  if (document === null || isOld) return warn(t("panel.noState"), t("panel.stands"));
  if (!isTracked) return warn(t("panel.trackingLost"), t("panel.stands"));
  if (outside !== null) return warn(t(`panel.outside.${outside}`), t("panel.stands"));
  const holders = holdersOf(document);
  if (failure !== null) holders.unshift(failure);
  if (session?.state === "paused") {
    const reasons = session.pauseReason.split(", ").filter((reason) => reason !== "");
    return warn(t("panel.paused"), ...reasons.map((reason) => t(`reason.${reason}`, { defaultValue: reason })), ...holders, t("panel.resume"));
  }
  if (isChoosing) return { title: t("panel.choose"), lines: [t("panel.chooseHow"), ...holders], isWarning: holders.length > 0, buttons };
  if (session === null) return { title: t("panel.welcome"), lines: [...holders, t("panel.seated"), t("panel.notSafe")], isWarning: holders.length > 0, buttons };
  const score = { caught: session.caught, throws: session.throws, score: session.score, metres: number(session.distanceM, i18next.language, { minimumFractionDigits: 1, maximumFractionDigits: 1 }) };
  const result = session.application === "juggling" ? t("panel.caught", score) : t("panel.walked", score);
  if (session.state === "ended") return { title: t("panel.ended"), lines: [result, ...holders], isWarning: holders.length > 0, buttons };
  const how = session.application === "walking" ? "panel.hold" : session.catch?.needsGrip === true ? "panel.catchGrip" : "panel.catch";
  return { title: result, lines: [t(how), ...holders], isWarning: holders.length > 0, buttons };
}

function actsIn({ document, mayChoose, mayExercise, isChoosing }: Situation): Act[] {
  const state = document?.session?.state;
  const acts: Act[] = [];
  if (mayExercise && state === "running") acts.push("pause");
  else if (mayExercise && state === "paused") acts.push("resume");
  else if (mayExercise && !isChoosing) acts.push("start");
  if (mayChoose && state !== "running" && document?.behaviour === "juggling") acts.push("choose");
  return [...acts, "recentre", "leave"];
}
