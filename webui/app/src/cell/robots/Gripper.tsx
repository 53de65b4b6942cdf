/** The gripper: its state, the part it holds, and a button that releases the part. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { requestService } from "~/api/http";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Button } from "~/design/Button";
import { useTopicSelector } from "~/live/hooks";

export function Gripper({ robot }: { robot: string }) {
  const { t } = useTranslation("system");
  const [asks, setAsks] = useState(false);
  const isClosed = useTopicSelector(`robot/${robot}`, (view) => view?.gripper.closed) === true;
  const holds = useTopicSelector(`robot/${robot}`, (view) => view?.gripper.holds ?? null);
  const interrupted = useTopicSelector(`robot/${robot}`, (view) => view?.gripper.interrupted ?? null);
  const works = useTopicSelector(`robot/${robot}`, (view) => view?.task != null);
  const free = () => requestService("trajectory-tool", `robots/${encodeURIComponent(robot)}/gripper/free`, { method: "POST" });
  return (
    <section className="gripper">
      <div>
        <h3>{t("gripper.title")}</h3>
        <p>{interrupted !== null ? t(`gripper.interrupted.${interrupted}`) : holds !== null ? t("gripper.holds", { part: holds }) : isClosed ? t("gripper.closed") : t("gripper.open")}</p>
      </div>
      <Button permission="moveRobots" isDisabled={works || (!isClosed && interrupted === null)} onPress={() => setAsks(true)}>
        {t("gripper.free")}
      </Button>
      <p className="gripper__why quiet small">{works ? t("gripper.notNow") : ""}</p>
      <ConfirmDialog
        isOpen={asks}
        onClose={() => setAsks(false)}
        title={t("gripper.ask", { robot })}
        act={t("gripper.free")}
        kind="stop"
        onAct={free}
      >
        <p>{holds === null ? t("gripper.meansEmpty") : t("gripper.means", { part: holds })}</p>
      </ConfirmDialog>
    </section>
  );
}
