/** Gloves: one card each. */
import { Hand } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { startOperator } from "~/api/acts";
import { describe } from "~/api/http";
import { Button } from "~/design/Button";
import { Empty } from "~/design/Empty";
import { Problem } from "~/design/Problem";
import { useTopic } from "~/live/hooks";
import { useGloveNames } from "~/live/names";
import { GloveCard } from "./GloveCard";
import "./GlovesPanel.css";

const FIRST_GLOVE = "glove-1";

export function GlovesPanel() {
  const gloves = useGloveNames();
  if (gloves.length === 0) return <NoGlove />;
  return (
    <div className="gloves">
      {gloves.map((glove) => (
        <GloveCard key={glove} glove={glove} />
      ))}
    </div>
  );
}

function NoGlove() {
  const { t } = useTranslation("system");
  const isRunning = useTopic("operator")?.running;
  const [failure, setFailure] = useState<string | null>(null);
  const start = () => {
    setFailure(null);
    startOperator(FIRST_GLOVE).catch((error: unknown) => setFailure(describe(error)));
  };
  return (
    <Empty
      icon={<Hand aria-hidden size={32} />}
      title={t("glove.none.title")}
      act={
        <Button kind="main" isDisabled={isRunning !== false} onPress={start}>
          {t("glove.none.act")}
        </Button>
      }
    >
      {failure === null ? t("glove.none.means") : <Problem>{failure}</Problem>}
    </Empty>
  );
}
