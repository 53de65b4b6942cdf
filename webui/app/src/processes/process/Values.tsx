/** The parameters and the present variables of a process. */
import { Braces } from "lucide-react";
import { useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { setVariables } from "~/api/actions";
import { Button } from "~/design/Button";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { MendDialog } from "../incidents/MendDialog";
import "./Values.css";

export function Values({ process }: { process: ProcessView }) {
  const { t } = useTranslation("processes");
  const [edits, setEdits] = useState(false);
  return (
    <div className="values">
      <Listed title={t("values.parameters")} values={process.parameters} empty={t("values.noParameters")} />
      <Listed title={t("values.variables")} values={process.variables} empty={t("values.noVariables")}>
        {process.endedAt === null && (
          <Button permission="runProcesses" icon={<Braces aria-hidden size={18} />} onPress={() => setEdits(true)}>
            {t("values.edit")}
          </Button>
        )}
      </Listed>
      {edits && (
        <MendDialog
          title={t("mend.set.title", { title: process.title })}
          act={t("mend.set.act")}
          means={t("mend.set.means")}
          variables={{ label: t("mend.variables"), hint: t("mend.variablesHint"), before: process.variables, isRequired: true }}
          onClose={() => setEdits(false)}
          onAct={(decision) => setVariables(process.id, decision)}
        />
      )}
    </div>
  );
}

interface ListedProps {
  title: string;
  values: Record<string, unknown>;
  empty: string;
  children?: ReactNode;
}

function Listed({ title, values, empty, children }: ListedProps) {
  const { t } = useTranslation("processes");
  const names = Object.keys(values).sort();
  return (
    <section>
      <header className="values__head">
        <h2>{title}</h2>
        {children}
      </header>
      {names.length === 0 ? (
        <p className="quiet">{empty}</p>
      ) : (
        <table className="values__table">
          <thead>
            <tr>
              <th scope="col">{t("values.name")}</th>
              <th scope="col">{t("values.value")}</th>
            </tr>
          </thead>
          <tbody>
            {names.map((name) => (
              <tr key={name}>
                <th scope="row">{name}</th>
                <td>
                  <Json value={values[name]} label={name} />
                </td>
              </tr>
            ))}
          </tbody>
        </table>
      )}
    </section>
  );
}

/** A value as JSON; a long one scrolls in its own place, which the keyboard reaches. */
export function Json({ value, label }: { value: unknown; label: string }) {
  const short = JSON.stringify(value ?? null);
  if (short.length <= 60) return <code className="values__json">{short}</code>;
  return (
    <pre className="values__json values__json--long" tabIndex={0} role="region" aria-label={label}>
      {written(value)}
    </pre>
  );
}

/** Over several lines, but lists of numbers (poses, joints) in one. */
function written(value: unknown): string {
  const numbers = /\[\s+([\d.e+-]+(?:,\s+[\d.e+-]+)*)\s+\]/g;
  return JSON.stringify(value, null, 2).replace(numbers, (_all, listed: string) => `[${listed.replace(/\s+/g, " ")}]`);
}
