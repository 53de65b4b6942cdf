/** The gloves of the cell, as a list. */
import { Hand } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { startOperator } from "~/api/actions";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { useTopic } from "~/live/hooks";
import { ObjectTable } from "../objects/ObjectTable";
import { useCellObjects } from "../objects/useCellObjects";

const DEFAULT_GLOVE = "glove-1";

export function GlovesPanel() {
  const { t } = useTranslation(["cell", "common"]);
  const { objects, isLoaded } = useCellObjects();
  const gloves = useMemo(() => objects.filter(({ kind }) => kind === "glove"), [objects]);
  if (gloves.length === 0) return isLoaded ? <NoGlove /> : <p className="quiet">{t("common:loading")}</p>;
  return <ObjectTable label={t("kinds.glove")} objects={gloves} view="" />;
}

function NoGlove() {
  const { t } = useTranslation("system");
  const isRunning = useTopic("operator")?.running;
  const [failure, setFailure] = useState<string | null>(null);
  const start = () => {
    setFailure(null);
    startOperator(DEFAULT_GLOVE).catch((error: unknown) => setFailure(errorText(error)));
  };
  return (
    <EmptyState
      icon={<Hand aria-hidden size={32} />}
      title={t("glove.none.title")}
      act={
        <Button permission="configure" kind="main" isDisabled={isRunning !== false} onPress={start}>
          {t("glove.none.act")}
        </Button>
      }
    >
      {failure === null ? t("glove.none.means") : <ErrorMessage>{failure}</ErrorMessage>}
    </EmptyState>
  );
}
