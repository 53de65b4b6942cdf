/** The state of an object as icon, word and colour. */
import { useTranslation } from "react-i18next";
import { StatusBadge } from "~/design/StatusBadge";
import { ConditionBadge } from "~/devices/ConditionBadge";
import type { CellObject } from "./cellObjects";

export function ObjectState({ object }: { object: CellObject }) {
  const { t } = useTranslation(["cell", "common"]);
  switch (object.kind) {
    case "robot":
      if (object.view === null) return object.registered === null ? null : <ConditionBadge device={object.registered} />;
      return <StatusBadge tone={object.tone}>{t(`common:deviceState.${object.view.deviceState}`)}</StatusBadge>;
    case "glove":
      return <StatusBadge tone={object.tone}>{object.view.connected ? t(`common:deviceState.${object.view.deviceState}`) : t("away")}</StatusBadge>;
    case "device":
    case "sensor":
      return <ConditionBadge device={object.view} />;
    case "other":
      return <StatusBadge tone={object.tone}>{object.view.deviceState === null ? t("noState") : t(`common:deviceState.${object.view.deviceState}`)}</StatusBadge>;
    case "service":
      return <StatusBadge tone={object.tone}>{t(`common:health.${object.view.state}`)}</StatusBadge>;
  }
}
