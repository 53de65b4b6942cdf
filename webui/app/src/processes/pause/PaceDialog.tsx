/** Asks before a process, those of a definition, or all are paused or resumed, under the name of the user and with a reason. */
import { useTranslation } from "react-i18next";
import { changePace, changePaceOfAll, type Pace } from "~/api/actions";
import { MendDialog } from "../incidents/MendDialog";
import { shortTitle } from "../names";

export interface PaceProps {
  pace: Pace;
  /** What is paused: a process, the processes of a definition, or everything. */
  of: { process: string; title: string } | { definition: string; title: string } | "everything";
  onDone?: () => void;
}

export function PaceDialog({ pace, of, onDone, onClose }: PaceProps & { onClose: () => void }) {
  const { t } = useTranslation("processes");
  const act = usePaceText({ pace, of });
  return (
    <MendDialog
      title={`${act}?`}
      act={act}
      means={t(`pace.${pace}.means`)}
      kind={pace === "pause" ? "stop" : "main"}
      onClose={onClose}
      onAct={async (decision) => {
        await (of !== "everything" && "process" in of ? changePace(of.process, pace, decision) : changePaceOfAll(pace, decision, of === "everything" ? undefined : of.definition));
        onDone?.();
      }}
    />
  );
}

export function usePaceText({ pace, of }: PaceProps): string {
  const { t } = useTranslation("processes");
  const scope = of === "everything" ? of : "process" in of ? "process" : "definition";
  return t(`pace.${pace}.${scope}`, { title: of === "everything" ? "" : shortTitle(of.title) });
}
