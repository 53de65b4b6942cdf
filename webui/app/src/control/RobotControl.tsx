/** The control of a robot: one person moves one robot by hand, alone or together with it. */
import { TriangleAlert } from "lucide-react";
import { useEffect, useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { Checkbox } from "~/design/Checkbox";
import { useIsOld, useTopic, useTopicSelector } from "~/live/hooks";
import { useRobotDescription, type JointDescription } from "~/robot/description";
import { OLD_AFTER_MS } from "./connection";
import { DevicesPanel } from "./DevicesPanel";
import { HoldBar } from "./HoldBar";
import { JogPanel } from "./JogPanel";
import { JointsPanel } from "./JointsPanel";
import { isLayout, STANDARD, type SidePanel } from "./layout";
import { LeaseCard } from "./LeaseCard";
import { PresetsPanel } from "./PresetsPanel";
import { useGatewayLease, useRegistered, useToolLease, type ControlledRobot, type Lease } from "./robots";
import { SharedPanel } from "./SharedPanel";
import { SidePanels } from "./SidePanels";
import { StatePanel } from "./StatePanel";
import type { Driver } from "./driver";
import { useDeviceSettings } from "./useDeviceSettings";
import { useControl, type Control } from "./useControl";
import { useUserSetting } from "./useUserSetting";
import { ViewPanel } from "./ViewPanel";
import "./RobotControl.css";

export default function RobotControl({ robot }: { robot: ControlledRobot }) {
  return (
    <div className="control">
      <Notice />
      {robot.service === "trajectory-tool" ? <ControlOf key={robot.name} robot={robot.name} /> : <ControlRegistered key={robot.name} robot={robot.name} />}
    </div>
  );
}

function Notice() {
  const { t } = useTranslation("control");
  const stop = useTopicSelector("cell", (cell) => cell?.emergencyStop);
  return (
    <p className="control__notice">
      <TriangleAlert aria-hidden size={18} />
      <span>
        <strong>{t("notice.title")}</strong> {stop === undefined ? t("notice.means") : t("notice.meansAt", { stop })}
      </span>
    </p>
  );
}

function ControlOf({ robot }: { robot: string }) {
  const control = useControl(robot);
  const revision = useTopicSelector(`robot/${robot}`, (view) => view?.revision) ?? "";
  const query = useRobotDescription(robot, revision);
  const live = useTopic(`robot/${robot}`);
  const lease = useToolLease(robot);
  const joints = query.description?.joints;
  const { driver, now } = control;
  const position = now.state?.joints.position ?? live?.joints.position;
  useJoints(driver, joints, position);
  const isOn = now.phase === "on";
  return (
    <Panels
      robot={{ service: "trajectory-tool", name: robot }}
      lease={lease}
      control={control}
      view={<ViewPanel robot={robot} query={query} />}
      jog={<JogPanel driver={driver} isOn={isOn} />}
      side={{
        joints: <JointsPanel driver={driver} isOn={isOn} joints={joints ?? []} position={position ?? []} />,
        presets: <PresetsPanel robot={robot} driver={driver} isOn={isOn} home={query.description?.home ?? null} position={position ?? []} />,
        shared: <SharedPanel driver={driver} state={now.state} />,
      }}
    />
  );
}

/** A robot that is registered at the device gateway: by velocities of its joints, and of its base if it walks or rolls. */
function ControlRegistered({ robot }: { robot: string }) {
  const { t } = useTranslation("control");
  const control = useControl(robot);
  const lease = useGatewayLease(robot);
  const { joints, walks } = useRegistered(robot);
  const { driver, now } = control;
  const position = now.state?.joints.position;
  useJoints(driver, joints, position);
  const isOn = now.phase === "on";
  return (
    <Panels
      robot={{ service: "device-gateway", name: robot }}
      lease={lease}
      control={control}
      view={<ViewPanel robot={robot} query={null} />}
      {...(walks ? { jog: <JogPanel driver={driver} isOn={isOn} isBase /> } : {})}
      side={{ joints: joints.length === 0 ? <p className="quiet">{t("joints.none")}</p> : <JointsPanel driver={driver} isOn={isOn} joints={joints} position={position ?? []} /> }}
    />
  );
}

function useJoints(driver: Driver, joints: readonly JointDescription[] | undefined, position: readonly number[] | undefined): void {
  useEffect(() => {
    driver.set({ joints: joints ?? [], position: position ?? [] });
  }, [driver, joints, position]);
}

interface PanelsProps {
  robot: ControlledRobot;
  lease: Lease;
  control: Control;
  view: ReactNode;
  jog?: ReactNode;
  side: Partial<Record<SidePanel, ReactNode>>;
}

function Panels({ robot, lease, control, view, jog, side }: PanelsProps) {
  const { t } = useTranslation("control");
  const [layout, change, isLoaded] = useUserSetting("control.layout", STANDARD, isLayout);
  const [isRecorded, setRecorded] = useState(false);
  const devices = useDeviceSettings(control.driver);
  const isServerOld = useIsOld(OLD_AFTER_MS);
  const isOld = isServerOld || control.now.isOld;
  const isOfTool = robot.service === "trajectory-tool";
  return (
    <>
      <LeaseCard robot={robot} lease={lease} control={control} isRecorded={isRecorded && isOfTool} isOld={isOld} />
      <div className="control__panels" data-old={isOld || undefined}>
        <Card
          className="control__panel control__panel--view"
          title={t("panel.view")}
          aside={
            <Button kind="quiet" onPress={() => change({ ...layout, isViewFolded: !layout.isViewFolded })}>
              {t(layout.isViewFolded ? "view.show" : "view.hide")}
            </Button>
          }
        >
          {isLoaded && !layout.isViewFolded && view}
        </Card>
        <StatePanel control={control} isOld={isOld} />
        {jog !== undefined && (
          <Card className="control__panel control__panel--jog" title={t(isOfTool ? "panel.jog" : "panel.base")}>
            {jog}
          </Card>
        )}
        <SidePanels
          panels={{
            ...side,
            devices: <DevicesPanel robot={robot.name} control={control} settings={devices} />,
            ...(isOfTool ? { recording: <RecordingPanel control={control} isRecorded={isRecorded} onChange={setRecorded} /> } : {}),
          }}
          shown={layout.side}
          isDisabled={!isLoaded}
          onShow={(panel) => change({ ...layout, side: panel })}
        />
      </div>
      <HoldBar control={control} isOld={isOld} />
    </>
  );
}

function RecordingPanel({ control: { now }, isRecorded, onChange }: { control: Control; isRecorded: boolean; onChange: (isRecorded: boolean) => void }) {
  const { t } = useTranslation("control");
  return (
    <div className="recording">
      {now.phase === "off" ? (
        <Checkbox isSelected={isRecorded} onChange={onChange}>
          {t("lease.record")}
        </Checkbox>
      ) : (
        <p>{t(now.state?.isRecorded === true ? "lease.recorded" : "lease.notRecorded")}</p>
      )}
      <p className="quiet">{t("lease.recordMeans")}</p>
    </div>
  );
}
