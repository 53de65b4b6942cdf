/** The activities of a definition as a table: what the diagram shows, for reading. */
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { duration } from "~/design/times";
import type { ElementCount } from "~/live/messages";
import type { DefinitionRecord } from "../records";

export interface ActivitiesProps {
  activities: DefinitionRecord["activities"];
  counts: Readonly<Record<string, ElementCount>>;
  onPick: (element: string) => void;
}

export function Activities({ activities, counts, onPick }: ActivitiesProps) {
  const { t, i18n } = useTranslation("processes");
  const said = (ms: number | null | undefined) => (ms == null ? "–" : duration(ms, i18n.language));
  return (
    <div className="definition__activities tasks__scroll" tabIndex={0} role="region" aria-label={t("activities.label")}>
      <table className="tasks__table">
        <thead>
          <tr>
            <th scope="col">{t("activities.name")}</th>
            <th scope="col">{t("activities.lane")}</th>
            {(["running", "completed", "failed", "last", "median"] as const).map((column) => (
              <th key={column} scope="col" className="tasks__number">
                {t(`activities.${column}`)}
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {activities.map((activity) => {
            const at = counts[activity.id];
            return (
              <tr key={activity.id} className="tasks__row">
                <th scope="row">
                  <Button kind="quiet" onPress={() => onPick(activity.id)}>
                    {activity.name === "" ? activity.id : activity.name}
                  </Button>
                </th>
                <td>{activity.lane}</td>
                <td className="tasks__number">{at?.running ?? 0}</td>
                <td className="tasks__number">{at?.completed ?? 0}</td>
                <td className="tasks__number">{at?.failed ?? 0}</td>
                <td className="tasks__number">{said(at?.lastMs)}</td>
                <td className="tasks__number">{said(at?.medianMs)}</td>
              </tr>
            );
          })}
        </tbody>
      </table>
    </div>
  );
}
