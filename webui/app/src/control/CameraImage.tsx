/** The newest image of a camera, with its age. */
import { useTranslation } from "react-i18next";
import type { CameraView } from "~/api/generated/device-gateway";
import { useServiceQuery } from "~/api/useServiceQuery";
import { StatusBadge } from "~/design/StatusBadge";

const LOOK_EVERY_MS = 200;
const LIST_EVERY_MS = 2000;
/** An image that is older no longer shows where the robot is. */
const STALE_S = 2;

/** The cameras that have sent images; asked often while one is shown. */
export function useCameras(isShown: boolean): readonly CameraView[] {
  const { value, failure } = useServiceQuery<CameraView[]>("device-gateway", "cameras", { intervalMs: isShown ? LOOK_EVERY_MS : LIST_EVERY_MS });
  // While the gateway does not answer, an old age must not be shown as the present one.
  return failure === null ? (value ?? []) : [];
}

export function CameraImage({ camera: { device, title, number, ageS } }: { camera: CameraView }) {
  const { t, i18n } = useTranslation("control");
  const isStale = ageS > STALE_S;
  const age = ageS.toLocaleString(i18n.language, { maximumFractionDigits: ageS < 10 ? 1 : 0, minimumFractionDigits: ageS < 10 ? 1 : 0 });
  return (
    <figure className="control__camera" data-stale={isStale || undefined}>
      <img src={`/api/device-gateway/devices/${encodeURIComponent(device)}/image?number=${number}`} alt={t("camera.image", { name: title === "" ? device : title })} />
      <figcaption>
        <StatusBadge tone={isStale ? "stop" : "ok"}>{t(isStale ? "camera.stale" : "camera.age", { age })}</StatusBadge>
      </figcaption>
    </figure>
  );
}
