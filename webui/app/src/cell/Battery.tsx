/** The level of a battery, and whether it should be charged. */
import { BatteryFull, BatteryLow, BatteryMedium, BatteryWarning } from "lucide-react";
import { useTranslation } from "react-i18next";
import { percent as percentOf } from "~/design/numbers";
import { StatusBadge } from "~/design/StatusBadge";

const LOW = 0.2;
const EMPTY = 0.08;

/** `level` from 0 to 1. */
export function Battery({ level }: { level: number }) {
  const { t, i18n } = useTranslation("system");
  const Icon = level < EMPTY ? BatteryWarning : level < LOW ? BatteryLow : level < 0.6 ? BatteryMedium : BatteryFull;
  const percent = percentOf(level, i18n.language);
  const tone = level < EMPTY ? "stop" : level < LOW ? "attention" : "neutral";
  return (
    <StatusBadge tone={tone} icon={<Icon aria-hidden size="1.2em" />}>
      {tone === "neutral" ? percent : t("battery.low", { percent })}
    </StatusBadge>
  );
}
