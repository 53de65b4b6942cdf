/** Alerts: those that stand, with what they mean and who knows of them; those that are over are folded away. */
import { ChevronRight, CircleCheck } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Button as PlainButton, Disclosure, DisclosurePanel, Heading } from "react-aria-components";
import { Empty } from "~/design/Empty";
import { useFamily } from "~/live/hooks";
import { AlertCard } from "./AlertCard";
import { sorted } from "./alerts";
import "./AlertsPanel.css";

export function AlertsPanel() {
  const { t } = useTranslation("system");
  const { standing, past } = sorted(useFamily("alert"));
  return (
    <div className="alerts">
      {standing.length === 0 ? (
        <Empty icon={<CircleCheck aria-hidden size={32} />} title={t("alert.none.title")}>
          {t("alert.none.means")}
        </Empty>
      ) : (
        <ul className="alerts__list" aria-label={t("alert.standing")}>
          {standing.map((alert) => (
            <AlertCard key={alert.id} alert={alert} />
          ))}
        </ul>
      )}
      {past.length > 0 && (
        <Disclosure className="alerts__past">
          <Heading level={2} className="alerts__past-head">
            <PlainButton slot="trigger" className="alerts__fold">
              <ChevronRight aria-hidden size={18} />
              {t("alert.past", { count: past.length })}
            </PlainButton>
          </Heading>
          <DisclosurePanel>
            <ul className="alerts__list" aria-label={t("alert.past", { count: past.length })}>
              {past.map((alert) => (
                <AlertCard key={alert.id} alert={alert} />
              ))}
            </ul>
          </DisclosurePanel>
        </Disclosure>
      )}
    </div>
  );
}
