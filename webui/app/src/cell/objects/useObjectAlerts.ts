/** The Alerts about an object: of its own, and of Tasks that involve it. */
import { useMemo } from "react";
import { compareUrgency } from "~/alerts/attention";
import type { AlertView } from "~/live/messages";
import { useSampledFamily } from "~/live/sampled";
import { isAbout, isOpen, subjectsOf, tasksOf } from "./cellObjects";

export interface ObjectId {
  /** The URN of its Device entity; null if it is not known. */
  entity: string | null;
  name: string;
}

/** The open ones, the most urgent first, and those that are shelved or have returned to normal of late, the newest first. */
export function useObjectAlerts({ entity, name }: ObjectId): { open: readonly AlertView[]; past: readonly AlertView[] } {
  const alerts = useSampledFamily("alert");
  const processes = useSampledFamily("process");
  return useMemo(() => {
    const tasks = tasksOf(processes);
    const own = alerts.filter(({ source }) => subjectsOf(source, tasks).some((subject) => isAbout(subject, entity, name)));
    return {
      open: own.filter(isOpen).sort(compareUrgency),
      past: own.filter((alert) => !isOpen(alert)).sort((a, b) => (a.dateIssued < b.dateIssued ? 1 : -1)),
    };
  }, [alerts, processes, entity, name]);
}
