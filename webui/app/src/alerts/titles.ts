/** The title of an Alert, in the language of the page if its kind is known. */
import { useCallback } from "react";
import { useTranslation } from "react-i18next";
import { localizedText } from "~/i18n/server";
import type { AlertView } from "~/live/messages";
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
