/** The gripper: whether it is open, what it holds, and a way to get a part out of it. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { callService } from "~/api/http";
import { Ask } from "~/design/Ask";
import { Button } from "~/design/Button";
import { usePick } from "~/live/hooks";

export function Gripper({ robot }: { robot: string }) {
  const { t } = useTranslation("system");
  const [asks, setAsks] = useState(false);
  const isClosed = usePick(`robot/${robot}`, (view) => view?.gripper.closed) === true;
  const holds = usePick(`robot/${robot}`, (view) => view?.gripper.holds ?? null);
  const works = usePick(`robot/${robot}`, (view) => view?.task != null);
  const free = () => callService("trajectory-tool", `robots/${encodeURIComponent(robot)}/gripper/free`, { method: "POST" });
  return (
    <section className="gripper">
      <div>
        <h3>{t("gripper.title")}</h3>
        <p>{holds !== null ? t("gripper.holds", { part: holds }) : isClosed ? t("gripper.closed") : t("gripper.open")}</p>
      </div>
      <Button isDisabled={works || !isClosed} onPress={() => setAsks(true)}>
        {t("gripper.free")}
      </Button>
      <p className="gripper__why quiet small">{works ? t("gripper.notNow") : ""}</p>
      <Ask
        isOpen={asks}
        onClose={() => setAsks(false)}
        title={t("gripper.ask", { robot })}
        act={t("gripper.free")}
        kind="stop"
        onAct={free}
      >
        <p>{holds === null ? t("gripper.meansEmpty") : t("gripper.means", { part: holds })}</p>
      </Ask>
    </section>
  );
}
