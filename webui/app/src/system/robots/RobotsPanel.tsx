/** Robots: one card each. */
import { Bot } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Empty } from "~/design/Empty";
import { useRobotNames } from "~/live/names";
import { RobotCard } from "./RobotCard";
import "./RobotsPanel.css";

export function RobotsPanel() {
  const { t } = useTranslation("system");
  const robots = useRobotNames();
  if (robots.length === 0) {
    return (
      <Empty icon={<Bot aria-hidden size={32} />} title={t("robot.none.title")}>
        {t("robot.none.means")} <code>{".venv/bin/handover run trajectory-tool"}</code>
      </Empty>
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
