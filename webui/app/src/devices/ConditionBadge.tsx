/** The condition of a device as icon, word and colour. */
import { CloudOff, Ruler, TimerOff } from "lucide-react";
import { useTranslation } from "react-i18next";
import { StatusBadge } from "~/design/StatusBadge";
import { deviceTone } from "~/design/states";
import type { RegisteredDeviceView } from "~/live/messages";
import { conditionOf, conditionTone } from "./values";

const icons = { away: CloudOff, stale: TimerOff, outOfRange: Ruler } as const;

export function ConditionBadge({ device }: { device: RegisteredDeviceView }) {
  const { t } = useTranslation(["devices", "common"]);
  const condition = conditionOf(device);
  if (condition === "ok" || condition === "fault") {
    const { state } = device;
    return <StatusBadge tone={state === null ? conditionTone[condition] : deviceTone[state]}>{state === null ? t("condition.ok") : t(`common:deviceState.${state}`)}</StatusBadge>;
  }
  const Icon = icons[condition];
  return (
    <StatusBadge tone={conditionTone[condition]} icon={<Icon aria-hidden size="1.15em" />}>
      {t(`condition.${condition}`)}
    </StatusBadge>
  );
}
