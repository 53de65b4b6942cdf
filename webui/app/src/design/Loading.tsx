/** What is shown until the content has been loaded. */
import { useTranslation } from "react-i18next";
import "./Loading.css";

/** `isPage`: in place of a whole page. */
export function Loading({ isPage = false, children }: { isPage?: boolean; children?: string }) {
  const { t } = useTranslation("common");
  return <p className={isPage ? "loading loading--page quiet" : "loading quiet"}>{children ?? t("loading")}</p>;
}
