/** What the page says of an event, in its own language; an event that it has no words for speaks English. */
import { useCallback } from "react";
import { useTranslation } from "react-i18next";
import { localizedText } from "~/i18n/server";
import type { LiveEvent } from "~/live/messages";

export function useMessageText(): (event: LiveEvent) => string {
  const { t, i18n } = useTranslation(["system", "common"]);
  return useCallback(
    (event: LiveEvent) => {
      const key = `event.${event.key}`;
      if (!i18n.exists(key, { ns: "system" })) return event.text;
      const { state, service } = event.values;
      const words = {
        ...event.values,
        ...(state === undefined ? {} : { state: t(`common:deviceState.${state}`, { defaultValue: String(state) }) }),
        ...(service === undefined ? {} : { service: t(`common:services.${service}`, { defaultValue: String(service) }) }),
      };
      const said = t(key, words);
      // The reason is translated if the component gave it a code.
      const why = localizedText(event.values, "reason") ?? event.values["detail"] ?? "";
      return why === "" ? said : `${said}: ${why}`;
    },
    [t, i18n],
  );
}
