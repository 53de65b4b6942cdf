/** What is paused or suspended of a definition, by whom and why, and the buttons that change it or delete it. */
import { CircleOff, CirclePlay, Trash2 } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { DefinitionView } from "~/api/generated/task-orchestrator";
import { requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { StatusBadge } from "~/design/StatusBadge";
import { MendDialog } from "../incidents/MendDialog";
import { shortTitle } from "../names";
import { SERVICE } from "../records";
import { PaceButton } from "./PaceButton";

export interface HoldsProps {
  definition: DefinitionView;
  /** The number of the latest version; an earlier one can be deleted by itself. */
  newest: number;
  onChanged: () => void;
  onDeleted: () => void;
}

export function Holds({ definition, newest, onChanged, onDeleted }: HoldsProps) {
  const { t } = useTranslation("processes");
  const [asks, setAsks] = useState(false);
  const [deletes, setDeletes] = useState(false);
  const [deletesVersion, setDeletesVersion] = useState(false);
  const { name, version, holds } = definition;
  const isDeleted = definition.deletedVersions.includes(version);
  const deleteVersion = t("hold.deleteVersion.act", { version });
  const title = shortTitle(definition.title);
  const does = holds.some(({ kind }) => kind === "suspended") ? "activate" : "suspend";
  const act = t(`hold.${does}.act`, { title });
  const path = `definitions/${encodeURIComponent(name)}`;
  return (
    <div className="definition__holds">
      {holds.map(({ kind, by, why, at }) => (
        <StatusBadge key={`${kind} ${at}`} tone="attention">
          {t(`hold.${kind === "suspended" ? "suspended" : "paused"}`, { by })}
          {why !== null && why !== "" && `: ${why}`}
        </StatusBadge>
      ))}
      {holds.some(({ kind }) => kind === "paused") && <PaceButton pace="resume" of={{ definition: name, title }} onDone={onChanged} />}
      <Button permission="runProcesses" icon={does === "suspend" ? <CircleOff aria-hidden size={18} /> : <CirclePlay aria-hidden size={18} />} onPress={() => setAsks(true)}>
        {act}
      </Button>
      <Button permission="deployProcesses" icon={<Trash2 aria-hidden size={18} />} onPress={() => setDeletes(true)}>
        {t("hold.delete.act", { title })}
      </Button>
      {version !== newest && !isDeleted && (
        <Button permission="deployProcesses" icon={<Trash2 aria-hidden size={18} />} onPress={() => setDeletesVersion(true)}>
          {deleteVersion}
        </Button>
      )}
      {isDeleted && <StatusBadge tone="attention">{t("hold.deleteVersion.done", { version })}</StatusBadge>}
      {asks && (
        <MendDialog
          title={`${act}?`}
          act={act}
          means={t(`hold.${does}.means`)}
          kind={does === "suspend" ? "stop" : "main"}
          onClose={() => setAsks(false)}
          onAct={(json) => requestService(SERVICE, `${path}/${does}`, { method: "POST", json }).then(onChanged)}
        />
      )}
      {deletesVersion && (
        <MendDialog
          title={`${deleteVersion}?`}
          act={deleteVersion}
          means={t("hold.deleteVersion.means")}
          kind="stop"
          onClose={() => setDeletesVersion(false)}
          onAct={({ by, why }) => requestService(SERVICE, `${path}/versions/${version}?${new URLSearchParams({ by, why: why ?? "" }).toString()}`, { method: "DELETE" }).then(onChanged)}
        />
      )}
      {deletes && (
        <MendDialog
          title={`${t("hold.delete.act", { title })}?`}
          act={t("hold.delete.act", { title })}
          means={t("hold.delete.means")}
          kind="stop"
          onClose={() => setDeletes(false)}
          onAct={({ by, why }) => requestService(SERVICE, `${path}?${new URLSearchParams({ by, why: why ?? "" }).toString()}`, { method: "DELETE" }).then(onDeleted)}
        />
      )}
    </div>
  );
}
