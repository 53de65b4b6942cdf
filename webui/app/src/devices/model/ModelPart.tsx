/** The model of a robot: its URDF in 3D with the live positions of its joints, and the upload of another one. */
import { Box, FileUp } from "lucide-react";
import { lazy, Suspense, useCallback, useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import type { DeviceDetails } from "~/api/generated/device-gateway";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { Checkbox } from "~/design/Checkbox";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { FileButton } from "~/design/FileButton";
import { number } from "~/design/numbers";
import { useLive } from "~/live/hooks";
import type { RegisteredDeviceView } from "~/live/messages";
import { textOf } from "~/processes/upload/file";
import type { Stage } from "~/robot3d/stage";
import { mayDo } from "~/session/session";
import { pathOf, saveUrdf, SERVICE } from "../gateway";
import { titleOf } from "../values";
import { linksWithMeshes } from "./meshes";
import { viewOf } from "./urdf";

const RobotView = lazy(() => import("~/robot3d/Robot3d").then(({ RobotView }) => ({ default: RobotView })));

interface ModelPartProps {
  device: RegisteredDeviceView;
  details: DeviceDetails;
  onChanged: () => void;
}

export function ModelPart({ device, details, onChanged }: ModelPartProps) {
  const { t, i18n } = useTranslation("devices");
  const hasUrdf = details.files.includes("urdf");
  const [revision, setRevision] = useState(0);
  const { value: stored, failure: away } = useServiceQuery<string>(SERVICE, hasUrdf ? `${pathOf(device.name)}/urdf` : null, { revision });
  const [picked, setPicked] = useState<{ name: string; urdf: string } | null>(null);
  const [takesJoints, setTakesJoints] = useState(true);
  const [failure, setFailure] = useState<string | null>(null);
  const [busy, setBusy] = useState(false);
  const urdf = picked?.urdf ?? stored;
  const view = useMemo(() => (urdf === null ? null : viewOf(urdf)), [urdf]);
  const follow = useFollow(device.entity);
  const pick = (file: File) => {
    setFailure(null);
    textOf(file).then(
      (text) => setPicked({ name: file.name, urdf: text }),
      (error: unknown) => setFailure(errorText(error)),
    );
  };
  const save = async () => {
    if (picked === null) return;
    setBusy(true);
    setFailure(null);
    try {
      await saveUrdf(device.name, picked.urdf, takesJoints);
      setPicked(null);
      setRevision((before) => before + 1);
      onChanged();
    } catch (error) {
      setFailure(errorText(error));
    } finally {
      setBusy(false);
    }
  };
  const joints = details.description.joints ?? [];
  const meshes = useMemo(() => (urdf === null ? [] : linksWithMeshes(urdf)), [urdf]);
  const value = (limit: number | null | undefined) => (limit == null ? "–" : number(limit, i18n.language, { maximumFractionDigits: 4 }));
  return (
    <div className="device__columns">
      <Card title={picked === null ? t("model.title") : t("model.preview", { file: picked.name })}>
        {view === null ? (
          (!hasUrdf || away !== null) && (
            <EmptyState icon={<Box aria-hidden size={32} />} title={t("model.none.title")}>
              {away ?? t("model.none.means")}
            </EmptyState>
          )
        ) : (
          <div className="device-model__view">
            <Suspense fallback={null}>
              <RobotView key={picked === null ? "stored" : picked.name} robot={titleOf(device)} description={view} failure={null} follow={follow} />
            </Suspense>
          </div>
        )}
        {meshes.length > 0 && <p className="quiet">{t("model.meshes", { count: meshes.length, links: meshes.join(", ") })}</p>}
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        {mayDo("configure") && (
          <div className="device-form__acts">
            <FileButton types={[".urdf", ".xml", "application/xml"]} icon={<FileUp aria-hidden size={18} />} onFile={pick}>
              {hasUrdf || picked !== null ? t("model.another") : t("model.choose")}
            </FileButton>
            {picked !== null && (
              <>
                <Checkbox isSelected={takesJoints} onChange={setTakesJoints}>
                  {t("model.joints", { count: view?.joints.length ?? 0 })}
                </Checkbox>
                <Button onPress={() => setPicked(null)}>{t("model.discard")}</Button>
                <Button kind="main" isDisabled={busy} onPress={() => void save()}>
                  {t("model.save")}
                </Button>
              </>
            )}
          </div>
        )}
      </Card>
      <Card title={t("form.joints")}>
        {joints.length === 0 ? (
          <p className="quiet">{t("model.noJoints")}</p>
        ) : (
          <div className="device__table" tabIndex={0} role="group" aria-label={t("form.joints")}>
            <table>
              <thead>
                <tr>
                  <th scope="col">{t("form.jointName")}</th>
                  <th scope="col">{t("form.jointType")}</th>
                  <th scope="col" data-number>{t("form.lower")}</th>
                  <th scope="col" data-number>{t("form.upper")}</th>
                  <th scope="col" data-number>{t("form.maxVelocity")}</th>
                </tr>
              </thead>
              <tbody>
                {joints.map((joint) => (
                  <tr key={joint.name}>
                    <th scope="row">{joint.name}</th>
                    <td>{t(`jointType.${joint.type ?? "revolute"}`)}</td>
                    <td data-number>{value(joint.lower)}</td>
                    <td data-number>{value(joint.upper)}</td>
                    <td data-number>{value(joint.maxVelocity)}</td>
                  </tr>
                ))}
              </tbody>
            </table>
          </div>
        )}
      </Card>
    </div>
  );
}

/** Moves the joints of the stage to the live values of a device. */
function useFollow(entity: string): (stage: Stage) => () => void {
  const live = useLive();
  return useCallback(
    (stage: Stage) => {
      const topic = `registeredDevice/${entity}` as const;
      const bend = () => {
        const values = Object.entries(live.value(topic)?.values ?? {});
        stage.joints(values.map(([name]) => name), values.map(([, { value }]) => value));
      };
      bend();
      return live.watch(topic, bend);
    },
    [live, entity],
  );
}
