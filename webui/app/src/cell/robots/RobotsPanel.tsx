/** The robots of the cell, as a list. */
import { Bot } from "lucide-react";
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import { EmptyState } from "~/design/EmptyState";
import { ObjectTable } from "../objects/ObjectTable";
import { useCellObjects } from "../objects/useCellObjects";

export function RobotsPanel() {
  const { t } = useTranslation(["system", "cell", "devices", "common"]);
  const { objects, isLoaded } = useCellObjects();
  const robots = useMemo(() => objects.filter(({ kind }) => kind === "robot"), [objects]);
  if (robots.length === 0) {
    if (!isLoaded) return <p className="quiet">{t("common:loading")}</p>;
    return (
      <EmptyState icon={<Bot aria-hidden size={32} />} title={t("robot.none.title")}>
        {t("robot.none.means")} <code>{".venv/bin/handover run trajectory-tool"}</code>
      </EmptyState>
    );
  }
  return <ObjectTable label={t("cell:kinds.robot")} objects={robots} view="" />;
}
