/** The glove of a page: named by the URL, else the first of the cell. */
import { Hand } from "lucide-react";
import { useTranslation } from "react-i18next";
import { useLocation } from "wouter";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { Select } from "~/design/Select";
import { useGloveNames } from "~/live/names";
import { useQueryParameter } from "~/route/queryParameter";

export function useSelectedGlove(): string | undefined {
  const gloves = useGloveNames();
  const [gloveParameter] = useQueryParameter("glove");
  return gloves.find((glove) => glove === gloveParameter) ?? gloves[0];
}

export function GloveSelect({ glove }: { glove: string }) {
  const { t } = useTranslation("common");
  const gloves = useGloveNames();
  const [, choose] = useQueryParameter("glove");
  return <Select label={t("glove.one")} value={glove} options={gloves.map((glove) => ({ value: glove, name: glove }))} onChange={choose} />;
}

/** Shown while there is no glove; `means` describes the content that is missing. */
export function NoGlove({ means }: { means: string }) {
  const { t } = useTranslation("common");
  const [, go] = useLocation();
  return (
    <EmptyState
      icon={<Hand aria-hidden size={32} />}
      title={t("glove.none")}
      act={
        <Button kind="main" onPress={() => go("/")}>
          {t("glove.connect")}
        </Button>
      }
    >
      {means}
    </EmptyState>
  );
}
