/** The form of a grant: a role, and what it is for, chosen from what exists. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Checkbox } from "~/design/Checkbox";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { ROLES } from "./accounts";
import { SCOPES, useResources, type GrantDraft } from "./grants";

const MAX_SHOWN = 60;
const SEARCHED_FROM = 8;

export function GrantForm({ draft, onChange }: { draft: GrantDraft; onChange: (draft: GrantDraft) => void }) {
  const { t } = useTranslation(["accounts", "roles"]);
  return (
    <>
      <Select
        label={t("grants.role")}
        value={draft.role}
        options={ROLES.map((value) => ({ value, name: t(`roles:name.${value}`) }))}
        onChange={(role) => onChange({ ...draft, role })}
      />
      <p className="quiet small">{t(`roles:may.${draft.role}`)}</p>
      <Select
        label={t("grants.for")}
        value={draft.scope}
        options={SCOPES.map((value) => ({ value, name: t(`grants.scope.${value}`) }))}
        onChange={(scope) => onChange({ ...draft, scope: SCOPES.find((one) => one === scope) ?? "all" })}
      />
      {draft.scope === "some" && <Resources chosen={draft.chosen} onChange={(chosen) => onChange({ ...draft, chosen })} />}
      {draft.scope === "pattern" && (
        <Field label={t("grants.pattern")} hint={t("grants.patternHint")} value={draft.pattern} onChange={(pattern) => onChange({ ...draft, pattern })} maxLength={300} />
      )}
    </>
  );
}

function Resources({ chosen, onChange }: { chosen: ReadonlySet<string>; onChange: (chosen: ReadonlySet<string>) => void }) {
  const { t } = useTranslation("accounts");
  const { resources, failure } = useResources();
  const [find, setFind] = useState("");
  const words = find.toLowerCase().split(/\s+/);
  const matching = resources.filter(({ id, kind }) => words.every((word) => `${id} ${t(`grants.kind.${kind}`)}`.toLowerCase().includes(word)));
  const toggle = (id: string, isChosen: boolean) => {
    const after = new Set(chosen);
    if (isChosen) after.add(id);
    else after.delete(id);
    onChange(after);
  };
  return (
    <fieldset className="accounts__resources">
      <legend>{t("grants.chosen", { count: chosen.size })}</legend>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {resources.length > SEARCHED_FROM && <Field label={t("grants.find")} type="search" value={find} onChange={setFind} />}
      <ul>
        {matching.slice(0, MAX_SHOWN).map(({ id, kind, name }) => (
          <li key={id}>
            <Checkbox isSelected={chosen.has(id)} onChange={(isChosen) => toggle(id, isChosen)}>
              {name} <span className="quiet">{t(`grants.kind.${kind}`)}</span>
            </Checkbox>
          </li>
        ))}
      </ul>
      {matching.length > MAX_SHOWN && <p className="quiet small">{t("grants.more", { count: matching.length - MAX_SHOWN })}</p>}
      {resources.length === 0 && failure === null && <p className="quiet">{t("grants.nothing")}</p>}
    </fieldset>
  );
}
