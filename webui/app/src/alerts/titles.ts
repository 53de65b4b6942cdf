/** The title of an Alert in the language of the page if its kind is known, and the name of its source. */
import { useCallback, useMemo } from "react";
import { useTranslation } from "react-i18next";
import { localizedText } from "~/i18n/server";
import { useFamily } from "~/live/hooks";
import type { AlertView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { nameOf } from "~/processes/names";
import { kindOf } from "./attention";

export function useAlertTitle(): (alert: AlertView) => string {
  const { t } = useTranslation("common");
  return useCallback(
    (alert: AlertView) => {
      const kind = kindOf(alert);
      return kind === "other" ? (localizedText(alert, "description") ?? alert.description) : t(`alertKind.${kind}`);
    },
    [t],
  );
}

/** The name of a process by its id, or of the source of an Alert by its URN: "Bin picking · order 7", not a hash. */
export function useSourceName(): (source: string) => string {
  const processes = useFamily("process");
  const names = useMemo(() => {
    const found = new Map<string, string>();
    for (const process of processes) {
      found.set(process.id, process.name);
      for (const task of process.tasks) found.set(shortName(task.id), `${nameOf(task)} · ${process.name}`);
    }
    return found;
  }, [processes]);
  return useCallback((source: string) => names.get(shortName(source)) ?? shortName(source), [names]);
}
