/** The limits of persons on the humanoid: each source with what it allows, and why. */
import { useTranslation } from "react-i18next";
import type { LimitSourceView } from "~/api/generated/whole-body-control";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Card } from "~/design/Card";
import { percent } from "~/design/numbers";
import { StatusBadge } from "~/design/StatusBadge";
import { limitText } from "./holders";
import { SERVICE, type LiveDocument } from "./humanoid";

const EVERY_MS = 2000;

export function LimitsCard({ document: { limit } }: { document: LiveDocument }) {
  const { t, i18n } = useTranslation("humanoid");
  const { value: sources } = useServiceQuery<LimitSourceView[]>(SERVICE, "limits", { intervalMs: EVERY_MS });
  const isFull = limit.factor >= 1 && !limit.needsReset;
  return (
    <Card
      title={t("limit.title")}
      aside={<StatusBadge tone={limit.factor <= 0 || limit.needsReset ? "stop" : isFull ? "ok" : "attention"}>{percent(limit.factor, i18n.language)}</StatusBadge>}
    >
      {sources !== null && sources.length === 0 ? (
        <p className="quiet">{t("limit.none")}</p>
      ) : (
        <ul className="humanoid__list">
          {sources?.map(({ source, fraction, reason, needsReset }) => (
            <li key={source}>
              <strong>{source}</strong> {fraction >= 1 ? t("limit.full") : limitText({ factor: fraction, rule: source, reason, needsReset })}
            </li>
          ))}
        </ul>
      )}
    </Card>
  );
}
