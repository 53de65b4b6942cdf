/** What became of a Task: created, offered, claimed, declined, and its statuses. */
import { useTranslation } from "react-i18next";
import type { TaskHistoryEntry } from "~/api/generated/task-orchestrator";
import { RelativeTime } from "~/design/RelativeTime";
import { localizedText } from "~/i18n/server";
import { shortName } from "~/live/urn";

export function History({ entries }: { entries: readonly TaskHistoryEntry[] }) {
  const { t } = useTranslation(["tasks", "common"]);
  const said = (entry: TaskHistoryEntry): string => {
    if (entry.status !== undefined) return t(`common:status.${entry.status}`);
    if (entry.kind === "offered") {
      const offered = (entry.offeredTo ?? []).map(shortName);
      return offered.length === 0 ? t("history.offeredToAll") : t("history.offered", { who: offered.join(", ") });
    }
    return t(`history.${entry.kind}`, { who: entry.by ?? "" });
  };
  return (
    <section className="task-history" aria-label={t("history.title")}>
      <h3>{t("history.title")}</h3>
      <ol>
        {entries.map((entry, nth) => {
          const text = localizedText(entry, "text") ?? entry.text;
          return (
            <li key={nth}>
              <span className="quiet small">
                <RelativeTime at={entry.at} isStop />
              </span>
              <span>
                {said(entry)}
                {text !== null && text !== "" && <span className="quiet">{`: ${text}`}</span>}
              </span>
            </li>
          );
        })}
      </ol>
    </section>
  );
}
