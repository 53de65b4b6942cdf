/** The status bar of the operator's page: glove, robot, process and the pause button. */
import { Bot, Hand as HandIcon, Pause, Play, Users, Workflow } from "lucide-react";
import type { ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { StatusBadge } from "~/design/StatusBadge";
import { deviceTone, processTone } from "~/design/states";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import type { GloveView, RobotView } from "~/live/messages";
import { processState } from "~/live/processState";
import type { OperatorActions } from "./useOperatorActions";

export interface StatusStripProps {
  glove: GloveView | null;
  robot: RobotView | null;
  process: ProcessView | null;
  pause: OperatorActions["pause"];
  busy: boolean;
  /** The connection is lost: old states are not shown as present ones. */
  unknown: boolean;
  /** Who has joined the station, where no header shows it. */
  account: ReactNode;
  /** Opens the choice of another glove, if there are several. */
  onChange: (() => void) | null;
}

export function StatusStrip({ glove, robot, process, pause, busy, unknown, account, onChange }: StatusStripProps) {
  const { t } = useTranslation(["work", "common"]);
  return (
    <section className="work__strip" aria-label={t("strip.label")}>
      <div className="work__states">
        {glove !== null && <GloveState glove={glove} />}
        {!unknown && robot !== null && (
          <StatusBadge tone={deviceTone[robot.deviceState]} icon={<Bot aria-hidden size="1.2em" />}>
            {t("strip.robot", { robot: robot.id, state: t(`common:deviceState.${robot.deviceState}`) })}
          </StatusBadge>
        )}
        {unknown ? (
          <StatusBadge tone="stop">{t("strip.unknown")}</StatusBadge>
        ) : process === null ? (
          <StatusBadge tone="neutral">{t("strip.noProcess")}</StatusBadge>
        ) : (
          <StatusBadge tone={processTone[processState(process)]} icon={<Workflow aria-hidden size="1.2em" />}>
            {process.status === "completed" ? (
              process.name
            ) : (
              <>
                <span aria-hidden>{t("strip.process", { ...process })}</span>
                <span className="visually-hidden">{t("strip.processLabel", { ...process })}</span>
              </>
            )}
          </StatusBadge>
        )}
      </div>
      <div className="work__strip-acts">
        {account}
        {onChange !== null && (
          <Button size="large" label={t("strip.change")} icon={<Users aria-hidden size="1em" />} onPress={onChange} />
        )}
        <Button
          size="large"
          icon={pause?.goesOn === true ? <Play aria-hidden size="1em" /> : <Pause aria-hidden size="1em" />}
          isDisabled={pause === null || busy}
          onPress={() => pause?.do()}
        >
          {t(pause?.goesOn === true ? "strip.goOn" : "strip.pause")}
        </Button>
      </div>
    </section>
  );
}

function GloveState({ glove }: { glove: GloveView }) {
  const { t } = useTranslation(["work", "common"]);
  const tone = glove.lost ? "stop" : glove.connected ? deviceTone[glove.deviceState] : "attention";
  const state = glove.lost
    ? t("strip.lost")
    : glove.connected
      ? t(`common:deviceState.${glove.deviceState}`)
      : t("strip.away");
  return (
    <StatusBadge tone={tone} icon={<HandIcon aria-hidden size="1.2em" />}>
      {t("strip.glove", { glove: glove.glove, state })}
    </StatusBadge>
  );
}
