/** Pauses or resumes a process, those of a definition, or all, after a question. */
import { Pause, Play } from "lucide-react";
import { useState } from "react";
import { Button } from "~/design/Button";
import { PaceDialog, usePaceText, type PaceProps } from "./PaceDialog";

export function PaceButton(props: PaceProps) {
  const [asks, setAsks] = useState(false);
  const act = usePaceText(props);
  return (
    <>
      <Button permission="runProcesses" icon={props.pace === "pause" ? <Pause aria-hidden size={18} /> : <Play aria-hidden size={18} />} onPress={() => setAsks(true)}>
        {act}
      </Button>
      {asks && <PaceDialog {...props} onClose={() => setAsks(false)} />}
    </>
  );
}
