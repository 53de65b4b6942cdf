/** Robots: one card each. */
import { Bot } from "lucide-react";
import { useTranslation } from "react-i18next";
import { EmptyState } from "~/design/EmptyState";
import { useRobotNames } from "~/live/names";
import { RobotCard } from "./RobotCard";
import "./RobotsPanel.css";

export function RobotsPanel() {
  const { t } = useTranslation("system");
  const robots = useRobotNames();
  if (robots.length === 0) {
    return (
      <EmptyState icon={<Bot aria-hidden size={32} />} title={t("robot.none.title")}>
        {t("robot.none.means")} <code>{".venv/bin/handover run trajectory-tool"}</code>
      </EmptyState>
    );
  }
  return (
    <div className="robots">
      {robots.map((robot) => (
        <RobotCard key={robot} robot={robot} />
      ))}
    </div>
  );
}
