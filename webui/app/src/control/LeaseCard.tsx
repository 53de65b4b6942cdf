/** Who controls the robot, and how this person gets, hands over and ends the control. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText, requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { mayDo } from "~/session/session";
import type { ControlledRobot, Lease } from "./robots";
import type { Control } from "./useControl";

interface LeaseCardProps {
  robot: ControlledRobot;
  lease: Lease;
  control: Control;
  /** Whether the next control is recorded. */
  isRecorded: boolean;
  isOld: boolean;
}

export function LeaseCard({ robot, lease, control: { connection, now }, isRecorded, isOld }: LeaseCardProps) {
  const { t } = useTranslation("control");
  const { holder } = lease;
  const isMine = now.phase === "on";
  const open = (mode: "refuse" | "wait" | "takeOver") => connection.open(robot.service, robot.name, mode, isRecorded);
  return (
    <Card
      className="lease"
      title={isMine ? t("lease.mine", { robot: robot.name }) : now.phase === "waiting" ? t("lease.waiting", { name: now.holder ?? "" }) : holder === null ? t("lease.free", { robot: robot.name }) : t("lease.taken", { name: holder, robot: robot.name })}
      aside={isOld ? <StatusBadge tone="stop">{t("lease.old")}</StatusBadge> : undefined}
    >
      <div className="lease__acts">
        {now.phase === "off" && holder === null && (
          <Button kind="main" onPress={() => open("refuse")}>
            {t("lease.take")}
          </Button>
        )}
        {now.phase === "off" && holder !== null && (
          <>
            <Button kind="main" onPress={() => open("wait")}>
              {t("lease.ask")}
            </Button>
            {mayDo("manageSettings") && (
              <Button kind="stop" onPress={() => open("takeOver")}>
                {t("lease.takeOver", { name: holder })}
              </Button>
            )}
          </>
        )}
        {now.phase === "connecting" && <p className="quiet">{t("lease.connecting")}</p>}
        {now.phase === "waiting" && <Button onPress={() => connection.close()}>{t("lease.stopWaiting")}</Button>}
        {isMine && <Button onPress={() => connection.close()}>{t("lease.end")}</Button>}
        {now.phase === "off" ? isRecorded && <p className="quiet">{t("lease.willRecord")}</p> : now.state?.isRecorded === true && <p className="quiet">{t("lease.recorded")}</p>}
        {isMine && <HandOver robot={robot} waiting={lease.waiting} />}
      </div>
      <Ended ended={now.ended} />
      {now.error !== null && <ErrorMessage>{now.error}</ErrorMessage>}
      {now.state?.fault != null && <ErrorMessage>{now.state.fault}</ErrorMessage>}
    </Card>
  );
}

const KNOWN_CODES = [4401, 4403, 4404, 4408, 4409, 4410, 4502, 4503];

function Ended({ ended }: { ended: { code: number; reason: string } | null }) {
  const { t } = useTranslation("control");
  if (ended === null) return null;
  const code = KNOWN_CODES.includes(ended.code) ? String(ended.code) : "other";
  return <ErrorMessage>{t(`ended.${code}`, { reason: ended.reason })}</ErrorMessage>;
}

function HandOver({ robot, waiting }: { robot: ControlledRobot; waiting: readonly { id: string; name: string }[] }) {
  const { t } = useTranslation("control");
  const [failure, setFailure] = useState<string | null>(null);
  const handOver = (to: string) => {
    setFailure(null);
    requestService(robot.service, `robots/${encodeURIComponent(robot.name)}/control/hand-over`, { method: "POST", json: { to } }).catch(
      (error: unknown) => setFailure(errorText(error)),
    );
  };
  return (
    <>
      {waiting.map(({ id, name }) => (
        <Button key={id} kind="main" onPress={() => handOver(id)}>
          {t("lease.handOver", { name })}
        </Button>
      ))}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </>
  );
}
