/** Who has a Task of the tasklist. */
import { useTranslation } from "react-i18next";
import { StatusBadge } from "~/design/StatusBadge";

export function TaskState({ claimedBy, isClaimable }: { claimedBy: string | null; isClaimable: boolean }) {
  const { t } = useTranslation("tasks");
  if (claimedBy !== null) return <StatusBadge tone="accent">{t("state.claimed", { who: claimedBy })}</StatusBadge>;
  if (isClaimable) return <StatusBadge tone="neutral">{t("state.free")}</StatusBadge>;
  return <StatusBadge tone="neutral">{t("state.performed")}</StatusBadge>;
}
