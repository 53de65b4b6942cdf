/** Says that what the address names does not exist. Nothing else is opened in its place. */
import { SearchX } from "lucide-react";
import type { ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { useQueryChange } from "./queryParameter";

export type NamedThing = "alert" | "case" | "device" | "gesture" | "glove" | "page" | "person" | "robot" | "session" | "task" | "test" | "user" | "value";

export function UnknownName({ thing, name, parameter, children }: { thing: NamedThing; name: string; parameter?: string; children?: ReactNode }) {
  const { t } = useTranslation("common");
  const change = useQueryChange();
  return (
    <EmptyState
      icon={<SearchX aria-hidden size={32} />}
      title={t(`unknown.${thing}`, { name })}
      act={parameter !== undefined && <Button onPress={() => change({ [parameter]: "" })}>{t("unknown.act")}</Button>}
    >
      {children ?? t("unknown.means")}
    </EmptyState>
  );
}
