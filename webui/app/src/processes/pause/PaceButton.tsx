/** Pauses or resumes a process, those of a definition, or all, under the name of the user and with a reason. */
import { Pause, Play } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { changePace, changePaceOfAll, type Pace } from "~/api/actions";
import { Button } from "~/design/Button";
import { shortTitle } from "../names";
import { MendDialog } from "../incidents/MendDialog";

export interface PaceButtonProps {
  pace: Pace;
  /** What is paused: a process, the processes of a definition, or everything. */
  of: { process: string; title: string } | { definition: string; title: string } | "everything";
  onDone?: () => void;
}

export function PaceButton({ pace, of, onDone = () => undefined }: PaceButtonProps) {
  const { t } = useTranslation("processes");
  const [asks, setAsks] = useState(false);
  const scope = of === "everything" ? of : "process" in of ? "process" : "definition";
  const title = of === "everything" ? "" : shortTitle(of.title);
  const act = t(`pace.${pace}.${scope}`, { title });
  return (
    <>
      <Button permission="runProcesses" icon={pace === "pause" ? <Pause aria-hidden size={18} /> : <Play aria-hidden size={18} />} onPress={() => setAsks(true)}>
        {act}
      </Button>
      {asks && (
        <MendDialog
          title={`${act}?`}
          act={act}
          means={t(`pace.${pace}.means`)}
          kind={pace === "pause" ? "stop" : "main"}
          onClose={() => setAsks(false)}
          onAct={async (decision) => {
            await (of !== "everything" && "process" in of ? changePace(of.process, pace, decision) : changePaceOfAll(pace, decision, of === "everything" ? undefined : of.definition));
            onDone();
          }}
        />
      )}
    </>
  );
}
