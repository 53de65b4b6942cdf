/** The glove of a page: named by the URL, else the first of the cell. A glove that the URL names and that does not exist is undefined. */
import { Hand } from "lucide-react";
import { useTranslation } from "react-i18next";
import { useLocation } from "wouter";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { Select } from "~/design/Select";
import { useHasSnapshot } from "~/live/hooks";
import { useGloveNames } from "~/live/names";
import { UnknownName } from "~/route/UnknownName";
import { useQueryParameter } from "~/route/queryParameter";

export function useSelectedGlove(): string | undefined {
  const gloves = useGloveNames();
  const [gloveParameter] = useQueryParameter("glove");
  return gloveParameter === "" ? gloves[0] : gloves.find((glove) => glove === gloveParameter);
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
  const [asked] = useQueryParameter("glove");
  const isLoaded = useHasSnapshot();
  if (asked !== "") return isLoaded ? <UnknownName thing="glove" name={asked} parameter="glove" /> : <p className="quiet">{t("loading")}</p>;
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
