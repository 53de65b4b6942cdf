/** The text of an event in the language of the page, or its English text if the page has no translation. */
import { useCallback } from "react";
import { useTranslation } from "react-i18next";
import { localizedText } from "~/i18n/server";
import type { LiveEvent } from "~/live/messages";
import { readable } from "~/live/readable";

/** A text or number as text; undefined for everything else. */
function plain(value: unknown): string | undefined {
  return typeof value === "string" || typeof value === "number" ? String(value) : undefined;
}

export function useMessageText(): (event: LiveEvent) => string {
  const { t, i18n } = useTranslation(["system", "common"]);
  return useCallback(
    (event: LiveEvent) => {
      const key = `event.${event.key}`;
      if (!i18n.exists(key, { ns: "system" })) return readable(event.text);
      const [state, service, detail] = ["state", "service", "detail"].map((name) => plain(event.values[name]));
      const words = {
        ...event.values,
        ...(state === undefined ? {} : { state: t(`common:deviceState.${state}`, { defaultValue: state }) }),
        ...(service === undefined ? {} : { service: t(`common:services.${service}`, { defaultValue: service }) }),
      };
      // A Task that involves nobody has no `who` yet; who completed it on a screen is in `by`.
      const who = ["who", "by"].map((name) => plain(event.values[name])).find((name) => name !== undefined && name !== "") ?? "";
      const text = event.key.startsWith("task.") && who === "" ? t(`event.taskOfPeople.${event.key.slice("task.".length)}`, words) : t(key, { ...words, ...(who === "" ? {} : { who }) });
      // The reason is translated if the component gave it a code.
      const why = localizedText(event.values, "reason") ?? detail ?? "";
      return why === "" ? text : `${text}: ${readable(why)}`;
    },
    [t, i18n],
  );
}
