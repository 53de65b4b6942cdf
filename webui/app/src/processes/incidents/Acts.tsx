/** What people did to a process: what, at which element, who, why, and the variables that they set. */
import { useTranslation } from "react-i18next";
import { exactTime } from "~/design/times";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { elementName, type BpmnElements } from "../diagram/elements";
import { nameOf } from "../names";
import { Json } from "../process/Values";
import "./Acts.css";

export function Acts({ process, elements }: { process: ProcessView; elements: BpmnElements }) {
  const { t, i18n } = useTranslation("processes");
  if (process.acts.length === 0) return <p className="acts acts--none quiet">{t("acts.none")}</p>;
  return (
    <div className="acts">
      <table className="values__table" aria-label={t("views.acts")}>
        <thead>
          <tr>
            {(["when", "what", "who", "why", "values"] as const).map((column) => (
              <th key={column} scope="col">
                {t(`acts.${column}`)}
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {process.acts.map((act, nth) => (
            <tr key={nth}>
              <td>
                <time dateTime={act.at}>{exactTime(act.at, i18n.language)}</time>
              </td>
              <th scope="row">
                {t(`acts.is.${act.act}`, {
                  step: stepOf(act.element, act.task),
                  target: act.to === null ? "" : elementName(elements, act.to),
                })}
              </th>
              <td>
                {act.by ?? t("process.somebody")} {act.by !== null && !act.verified && <span className="quiet small">{t("acts.unverified")}</span>}
              </td>
              <td>{act.why}</td>
              <td>{act.values !== null && <Json value={act.values} label={t("acts.values")} />}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );

  function stepOf(element: string | null, task: string | null): string {
    const known = process.tasks.find(({ id }) => id === task);
    if (known !== undefined) return nameOf(known);
    return element === null ? process.title : elementName(elements, element);
  }
}
