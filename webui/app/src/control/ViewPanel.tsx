/** The robot in 3D, or the image of a camera. */
import { lazy, Suspense, useState } from "react";
import { useTranslation } from "react-i18next";
import { Select } from "~/design/Select";
import type { DescriptionQuery } from "~/robot/description";
import { CameraImage, useCameras } from "./CameraImage";

const Robot3d = lazy(() => import("~/robot3d/Robot3d"));

/** Without a description of the robot there are only the images of cameras. */
export function ViewPanel({ robot, query }: { robot: string; query: DescriptionQuery | null }) {
  const { t } = useTranslation("control");
  const [chosen, choose] = useState("");
  const cameras = useCameras(chosen !== "" || query === null);
  const camera = cameras.find(({ device }) => device === chosen) ?? (query === null ? cameras[0] : undefined);
  const options = [...(query === null ? [] : [{ value: "", name: t("camera.none") }]), ...cameras.map(({ device, title }) => ({ value: device, name: title === "" ? device : `${title} (${device})` }))];
  return (
    <>
      {cameras.length > 0 && <Select label={t("camera.view")} value={camera?.device ?? ""} options={options} onChange={choose} />}
      {camera !== undefined && <CameraImage camera={camera} />}
      {camera === undefined && query === null && <p className="quiet">{t("camera.noCamera")}</p>}
      {camera === undefined && query !== null && (
        <div className="control__view">
          <Suspense fallback={<p className="quiet">{t("loadingView")}</p>}>
            <Robot3d key={query.description?.revision} robot={robot} {...query} />
          </Suspense>
        </div>
      )}
    </>
  );
}
