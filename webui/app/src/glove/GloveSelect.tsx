/** Of the gloves of the cell, the one that a page is about: the URL holds it, the first where it names none. */
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
  const [asked] = useQueryParameter("glove");
  return gloves.find((one) => one === asked) ?? gloves[0];
}

export function GloveSelect({ glove }: { glove: string }) {
  const { t } = useTranslation("common");
  const gloves = useGloveNames();
  const [, choose] = useQueryParameter("glove");
  return <Select label={t("glove.one")} value={glove} options={gloves.map((one) => ({ value: one, name: one }))} onChange={choose} />;
}

/** Stands where there is no glove yet: `means` says what would be here. */
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
