/** The 3D view of the robot. */
import { lazy, Suspense } from "react";
import { useTranslation } from "react-i18next";
import type { DescriptionQuery } from "~/robot/description";

const Robot3d = lazy(() => import("~/robot3d/Robot3d"));

export function ViewPanel({ robot, query }: { robot: string; query: DescriptionQuery }) {
  const { t } = useTranslation("control");
  return (
    <div className="control__view">
      <Suspense fallback={<p className="quiet">{t("loadingView")}</p>}>
        <Robot3d key={query.description?.revision} robot={robot} {...query} />
      </Suspense>
    </div>
  );
}
