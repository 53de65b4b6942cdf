/** A robot waits for a person to confirm a hand-over: what to do, and a button that can be pressed with a glove. */
import { Handshake } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText, requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import type { RobotView } from "~/live/messages";
import "./HandOver.css";

export function HandOver({ robot }: { robot: RobotView }) {
  const { t } = useTranslation("system");
  const [failure, setFailure] = useState<string | null>(null);
  const [confirmed, setConfirmed] = useState<string | null>(null);
  if (!robot.awaitsConfirmation || robot.task === null) return null;
  const task = robot.task;
  const part = robot.gripper.holds;
  const confirm = () => {
    setFailure(null);
    setConfirmed(task);
    requestService("trajectory-tool", `robots/${encodeURIComponent(robot.id)}/confirm`, { method: "POST", json: { task } }).catch((error: unknown) => {
      setFailure(errorText(error));
      setConfirmed(null);
    });
  };
  return (
    <section className="hand-over" role="status">
      <p>{part === null ? t("handOver.take") : t("handOver.give", { part })}</p>
      <Button permission="performTasks" kind="main" size="large" icon={<Handshake aria-hidden size={24} />} isDisabled={confirmed === task} onPress={confirm}>
        {part === null ? t("handOver.confirmTake") : t("handOver.confirmGive")}
      </Button>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </section>
  );
}
