/** The cell in 3D as the map of its robots; it can be folded, and three.js loads only while it is open. */
import { lazy, Suspense, useState } from "react";
import { ChevronDown } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { useTopicSelector } from "~/live/hooks";
import { useRobotNames } from "~/live/names";
import { addresses } from "~/places/addresses";
import { useRobotDescription } from "~/robot/description";

const Robot3d = lazy(() => import("~/robot3d/Robot3d"));

const STORAGE_KEY = "handover.cell.map";
/** On a phone the list comes first. */
const MIN_OPEN_PX = 900;

export function CellMap() {
  const { t } = useTranslation("cell");
  const robots = useRobotNames();
  const [isOpen, setIsOpen] = useState(() => (localStorage.getItem(STORAGE_KEY) ?? (innerWidth >= MIN_OPEN_PX ? "open" : "")) === "open");
  const [first] = robots;
  if (first === undefined) return null;
  return (
    <details
      className="cell-map"
      open={isOpen}
      onToggle={(event) => {
        const { open } = event.currentTarget;
        setIsOpen(open);
        if (open !== isOpen) localStorage.setItem(STORAGE_KEY, open ? "open" : "folded");
      }}
    >
      <summary>
        <ChevronDown aria-hidden size={18} />
        <h2>{t("map.title")}</h2>
      </summary>
      {isOpen && (
        <>
          <div className="cell-map__view">
            <Suspense fallback={<p className="quiet">{t("map.loading")}</p>}>
              <View robot={first} />
            </Suspense>
          </div>
          <nav className="cell-map__robots" aria-label={t("map.title")}>
            {robots.map((robot) => (
              <Link key={robot} href={addresses.robot(robot)}>
                {robot}
              </Link>
            ))}
          </nav>
        </>
      )}
    </details>
  );
}

/** A robot with the others around it. */
function View({ robot }: { robot: string }) {
  const revision = useTopicSelector(`robot/${robot}`, (view) => view?.revision) ?? "";
  const query = useRobotDescription(robot, revision);
  return <Robot3d key={query.description?.revision} robot={robot} {...query} />;
}
