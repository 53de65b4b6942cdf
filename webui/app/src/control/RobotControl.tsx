/** The control of a robot: one person moves one robot by hand, alone or together with it. */
import { TriangleAlert } from "lucide-react";
import { useEffect, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Card } from "~/design/Card";
import { EmptyState } from "~/design/EmptyState";
import { useTopic, useTopicSelector } from "~/live/hooks";
import { useRobotDescription, type JointDescription } from "~/robot/description";
import { mayDo } from "~/session/session";
import { ArrangeMenu, PanelActions } from "./Arrange";
import { DevicesPanel } from "./DevicesPanel";
import { HoldBar } from "./HoldBar";
import { JogPanel } from "./JogPanel";
import { JointsPanel } from "./JointsPanel";
import { LatencyPanel } from "./LatencyPanel";
import { LeaseCard } from "./LeaseCard";
import { isArrangement, ordered, STANDARD, type PanelId } from "./panels";
import { PresetsPanel } from "./PresetsPanel";
import { useGatewayLease, useRegistered, useToolLease, type ControlledRobot, type Lease } from "./robots";
import { SharedPanel } from "./SharedPanel";
import type { Driver } from "./driver";
import { useControl, type Control } from "./useControl";
import { useUserSetting } from "./useUserSetting";
import { ViewPanel } from "./ViewPanel";
import "./RobotControl.css";

export default function RobotControl({ robot }: { robot: ControlledRobot }) {
  const { t } = useTranslation(["control", "common"]);
  if (!mayDo("moveRobots")) return <EmptyState title={t("notAllowed.title")}>{t("notAllowed.means")}</EmptyState>;
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
      panels={{
        view: <ViewPanel robot={robot} query={query} />,
        jog: <JogPanel driver={driver} isOn={isOn} />,
        joints: <JointsPanel driver={driver} isOn={isOn} joints={joints ?? []} position={position ?? []} />,
        shared: <SharedPanel driver={driver} state={now.state} />,
        presets: <PresetsPanel robot={robot} driver={driver} isOn={isOn} home={query.description?.home ?? null} position={position ?? []} />,
        devices: <DevicesPanel robot={robot} control={control} />,
        latency: <LatencyPanel now={now} />,
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
      panels={{
        view: <ViewPanel robot={robot} query={null} />,
        ...(walks ? { jog: <JogPanel driver={driver} isOn={isOn} isBase /> } : {}),
        joints: joints.length === 0 ? <p className="quiet">{t("joints.none")}</p> : <JointsPanel driver={driver} isOn={isOn} joints={joints} position={position ?? []} />,
        devices: <DevicesPanel robot={robot} control={control} />,
        latency: <LatencyPanel now={now} />,
      }}
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
  panels: Partial<Record<PanelId, ReactNode>>;
}

function Panels({ robot, lease, control, panels }: PanelsProps) {
  const { t } = useTranslation("control");
  const [arrangement, arrange, isLoaded] = useUserSetting("control.panels", STANDARD, isArrangement);
  const shown = ordered(arrangement).filter((panel) => isLoaded && panels[panel] !== undefined && !arrangement.hidden.includes(panel));
  return (
    <>
      <LeaseCard robot={robot} lease={lease} control={control} />
      <div className="control__panels">
        {shown.map((panel) => (
          <Card
            key={panel}
            className={`control__panel control__panel--${panel}`}
            title={t(panel === "jog" && robot.service === "device-gateway" ? "panel.base" : `panel.${panel}`)}
            aside={<PanelActions panel={panel} arrangement={arrangement} onArrange={arrange} />}
          >
            {panels[panel]}
          </Card>
        ))}
      </div>
      {isLoaded && <ArrangeMenu arrangement={arrangement} onArrange={arrange} />}
      <HoldBar control={control} />
    </>
  );
}
