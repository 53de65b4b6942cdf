/** The parameters and the present variables of a process, and those that only a part of it sees. */
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
  // What is edited: the variables of the process itself (no scope), or of a part of it.
  const [edited, setEdited] = useState<{ scope?: string; before: Readonly<Record<string, unknown>> } | null>(null);
  const edit = (part: { scope?: string; before: Readonly<Record<string, unknown>> }) =>
    process.endedAt === null && (
      <Button permission="runProcesses" icon={<Braces aria-hidden size={18} />} onPress={() => setEdited(part)}>
        {t("values.edit")}
      </Button>
    );
  return (
    <div className="values">
      <Listed title={t("values.parameters")} values={process.parameters} empty={t("values.noParameters")} />
      <Listed title={t("values.variables")} values={process.variables} empty={t("values.noVariables")}>
        {edit({ before: process.variables })}
      </Listed>
      {process.scopes.map(({ scope, kind, name, element, instance, variables }) => (
        <Listed
          key={scope}
          title={t(`values.scope.${kind}`, { name: `${name === "" ? element : name}${instance === "" ? "" : ` (${instance})`}` })}
          values={variables}
          empty={t("values.noVariables")}
        >
          {edit({ scope, before: variables })}
        </Listed>
      ))}
      {edited !== null && (
        <MendDialog
          title={t("mend.set.title", { title: process.name })}
          act={t("mend.set.act")}
          means={t("mend.set.means")}
          variables={{ label: t("mend.variables"), hint: t("mend.variablesHint"), before: edited.before, isRequired: true }}
          onClose={() => setEdited(null)}
          onAct={(decision) => setVariables(process.id, { ...decision, scope: edited.scope ?? null })}
        />
      )}
    </div>
  );
}

interface ListedProps {
  title: string;
  values: Readonly<Record<string, unknown>>;
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
