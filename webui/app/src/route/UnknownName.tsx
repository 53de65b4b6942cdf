/** Says that what the address names does not exist. Nothing else is opened in its place. */
import { SearchX } from "lucide-react";
import type { ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { useQueryChange } from "./queryParameter";

export type NamedThing = "alert" | "case" | "device" | "gesture" | "glove" | "page" | "person" | "robot" | "session" | "task" | "test" | "user" | "value";

/** `parameter` is what named it in the query of the address; `list` is the address of what there is. */
export function UnknownName({ thing, name, parameter, list, children }: { thing: NamedThing; name: string; parameter?: string; list?: string; children?: ReactNode }) {
  const { t } = useTranslation("common");
  const change = useQueryChange();
  return (
    <EmptyState
      icon={<SearchX aria-hidden size={32} />}
      title={t(`unknown.${thing}`, { name })}
      act={
        list !== undefined ? (
          <Link href={list}>{t("unknown.act")}</Link>
        ) : (
          parameter !== undefined && <Button onPress={() => change({ [parameter]: "" })}>{t("unknown.act")}</Button>
        )
      }
    >
      {children ?? t("unknown.means")}
    </EmptyState>
  );
}
