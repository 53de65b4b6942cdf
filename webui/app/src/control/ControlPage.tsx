/** The Control page: one person moves one robot by hand, alone or together with it. */
import { Gamepad2, TriangleAlert } from "lucide-react";
import { useEffect, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Card } from "~/design/Card";
import { EmptyState } from "~/design/EmptyState";
import { Select } from "~/design/Select";
import { useTopic, useTopicSelector } from "~/live/hooks";
import { useRobotNames } from "~/live/names";
import { useRobotDescription } from "~/robot/description";
import { useQueryParameter } from "~/route/queryParameter";
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
import { SharedPanel } from "./SharedPanel";
import { useControl } from "./useControl";
import { useUserSetting } from "./useUserSetting";
import { ViewPanel } from "./ViewPanel";
import "./ControlPage.css";

export default function ControlPage() {
  const { t } = useTranslation("control");
  const robots = useRobotNames();
  const [wanted, setWanted] = useQueryParameter("robot");
  const robot = robots.includes(wanted) ? wanted : robots[0];
  if (!mayDo("moveRobots")) return <EmptyState title={t("notAllowed.title")}>{t("notAllowed.means")}</EmptyState>;
  if (robot === undefined) {
    return (
      <EmptyState icon={<Gamepad2 aria-hidden size={32} />} title={t("none.title")}>
        {t("none.means")} <code>{".venv/bin/handover run trajectory-tool"}</code>
      </EmptyState>
    );
  }
  return (
    <div className="control">
      <header className="control__head">
        <h1 className="visually-hidden">{t("title")}</h1>
        <Select label={t("robot")} value={robot} options={robots.map((name) => ({ value: name, name }))} onChange={setWanted} />
        <Notice />
      </header>
      <ControlOf key={robot} robot={robot} />
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
  const { t } = useTranslation("control");
  const control = useControl(robot);
  const revision = useTopicSelector(`robot/${robot}`, (view) => view?.revision) ?? "";
  const query = useRobotDescription(robot, revision);
  const live = useTopic(`robot/${robot}`);
  const [arrangement, arrange] = useUserSetting("control.panels", STANDARD, isArrangement);
  const joints = query.description?.joints;
  const { driver, now } = control;
  const position = now.state?.joints.position ?? live?.joints.position;
  useEffect(() => {
    driver.set({ joints: joints ?? [], position: position ?? [] });
  }, [driver, joints, position]);
  const isOn = now.phase === "on";
  const panels: Record<PanelId, ReactNode> = {
    view: <ViewPanel robot={robot} query={query} />,
    jog: <JogPanel driver={driver} isOn={isOn} />,
    joints: <JointsPanel driver={driver} isOn={isOn} joints={joints ?? []} position={position ?? []} />,
    shared: <SharedPanel driver={driver} state={now.state} />,
    presets: <PresetsPanel robot={robot} driver={driver} isOn={isOn} home={query.description?.home ?? null} position={position ?? []} />,
    devices: <DevicesPanel driver={driver} />,
    latency: <LatencyPanel now={now} />,
  };
  const shown = ordered(arrangement).filter((panel) => !arrangement.hidden.includes(panel));
  return (
    <>
      <LeaseCard robot={robot} control={control} />
      <div className="control__panels">
        {shown.map((panel) => (
          <Card
            key={panel}
            className={`control__panel control__panel--${panel}`}
            title={t(`panel.${panel}`)}
            aside={<PanelActions panel={panel} arrangement={arrangement} onArrange={arrange} />}
          >
            {panels[panel]}
          </Card>
        ))}
      </div>
      <ArrangeMenu arrangement={arrangement} onArrange={arrange} />
      <HoldBar control={control} />
    </>
  );
}
