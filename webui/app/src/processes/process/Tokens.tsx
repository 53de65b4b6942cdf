/** Where a process is: each of its tokens with its step, also two at one step, what it does and its Task. */
import { useTranslation } from "react-i18next";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { Button } from "~/design/Button";
import { elementName, type BpmnElements } from "../diagram/elements";
import { nameOf, taskMark } from "../names";
import "./Values.css";

/** The orchestrator lists as many. */
const MAX_LISTED = 1000;

export interface TokensProps {
  process: Pick<ProcessView, "tokens" | "tasks">;
  elements: BpmnElements;
  onPick: (task: string) => void;
}

export function Tokens({ process: { tokens, tasks }, elements, onPick }: TokensProps) {
  const { t } = useTranslation("processes");
  if (tokens.length === 0) return <p className="values quiet">{t("tokens.none")}</p>;
  const byId = new Map(tasks.map((task) => [task.id, task]));
  return (
    <div className="values values--one">
      {tokens.length >= MAX_LISTED && <p className="quiet">{t("tokens.more", { count: MAX_LISTED })}</p>}
      <table className="values__table" aria-label={t("views.tokens")}>
        <thead>
          <tr>
            <th scope="col">{t("tokens.step")}</th>
            <th scope="col">{t("tokens.instance")}</th>
            <th scope="col">{t("tokens.state")}</th>
            <th scope="col">{t("tokens.task")}</th>
          </tr>
        </thead>
        <tbody>
          {tokens.map(({ token, element, name, state, instance, task }) => {
            const open = task === null ? undefined : byId.get(task);
            return (
              <tr key={token}>
                <th scope="row">{name === "" ? elementName(elements, element) : name}</th>
                <td>{instance}</td>
                <td>{t(`tokens.is.${state}`)}</td>
                <td>
                  {open !== undefined && (
                    <Button kind="quiet" onPress={() => onPick(taskMark(open))}>
                      {nameOf(open)}
                    </Button>
                  )}
                </td>
              </tr>
            );
          })}
        </tbody>
      </table>
    </div>
  );
}
