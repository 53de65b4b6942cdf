/** Retries a step with an incident under the name of the user. */
import { RotateCcw } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { retryToken } from "~/api/actions";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { useWithName } from "~/shell/userName";

export interface RetryButtonProps {
  process: ProcessView;
  token: string;
  step: string;
  kind: "main" | "plain";
}

export function RetryButton({ process, token, step, kind }: RetryButtonProps) {
  const { t } = useTranslation("processes");
  const { withName, question } = useWithName();
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const retry = (by: string) => retryToken(process.id, token, { by });
  return (
    <>
      <Button permission="runProcesses"
        kind={kind}
        icon={<RotateCcw aria-hidden size={18} />}
        isDisabled={busy}
        onPress={() => {
          setBusy(true);
          setFailure(null);
          void withName(retry)
            .catch((error: unknown) => setFailure(errorText(error)))
            .finally(() => setBusy(false));
        }}
      >
        {t("retry.act", { task: step })}
      </Button>
      {failure !== null && <ErrorMessage>{t("retry.refused", { why: failure })}</ErrorMessage>}
      {question}
    </>
  );
}
