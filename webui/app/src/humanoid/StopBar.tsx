/** Stop, always in sight, and what holds the humanoid: a stop, a limit, a fault. */
import { OctagonX, RotateCcw } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText, requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { mayDo } from "~/session/session";
import { useUserName } from "~/shell/userName";
import { SERVICE, type LiveDocument } from "./humanoid";
import { holdersOf, needsRestart } from "./holders";
import "./HumanoidPage.css";

export function StopBar({ document }: { document: LiveDocument | null }) {
  const { t } = useTranslation("humanoid");
  const who = useUserName();
  const [failure, setFailure] = useState<string | null>(null);
  const act = (path: string, json?: unknown) => {
    setFailure(null);
    requestService(SERVICE, path, { method: "POST", ...(json === undefined ? {} : { json }) }).catch((error: unknown) => setFailure(errorText(error)));
  };
  const holders = document === null ? [] : holdersOf(document);
  const isStopped = document?.stop.isStopped === true;
  return (
    <div className="humanoid-stop" data-stopped={isStopped || undefined}>
      <Button
        kind="stop"
        size="large"
        icon={<OctagonX aria-hidden size={30} />}
        isDisabled={!mayDo("performTasks")}
        onPress={() => act("stop", { reason: t("stop.by", { who }) })}
      >
        {t("stop.act")}
      </Button>
      <div className="humanoid-stop__text">
        <p role="status">{holders.length === 0 ? t("stop.means") : holders.join(" · ")}</p>
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      </div>
      {mayDo("moveRobots") && (isStopped || document?.limit.needsReset === true) && (
        <Button icon={<RotateCcw aria-hidden size={20} />} onPress={() => act("reset")}>
          {t("stop.reset")}
        </Button>
      )}
      {mayDo("moveRobots") && document !== null && needsRestart(document) && (
        <Button icon={<RotateCcw aria-hidden size={20} />} onPress={() => act("restart")}>
          {t("stop.restart")}
        </Button>
      )}
    </div>
  );
}
