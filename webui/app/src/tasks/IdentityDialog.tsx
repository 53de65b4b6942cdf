/** Who works at this screen, and in which groups: asked once, kept on this device. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { AgentView } from "~/api/generated/task-orchestrator";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Checkbox } from "~/design/Checkbox";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { shortName } from "~/live/urn";
import { useSession } from "~/session/session";
import { setUserGroups, userGroups } from "~/shell/userGroups";
import { UserNameField, setUserName, userName } from "~/shell/userName";

export interface IdentityDialogProps {
  /** The groups that Tasks are offered to. */
  offered: readonly string[];
  onClose: () => void;
}

export function IdentityDialog({ offered, onClose }: IdentityDialogProps) {
  const { t } = useTranslation("tasks");
  const { hasAccounts } = useSession();
  const { value: agents } = useServiceQuery<AgentView[]>("task-orchestrator", "agents");
  const [name, setName] = useState(userName());
  const [groups, setGroups] = useState<readonly string[]>(userGroups());
  const [more, setMore] = useState("");
  const persons = (agents ?? []).filter(({ id }) => id.includes(":Person:"));
  const known = [...new Set([...groups, ...offered, ...persons.flatMap(({ roles }) => roles)])].sort((a, b) => a.localeCompare(b));
  const choose = (person: string) => {
    const found = persons.find(({ id }) => shortName(id) === person);
    if (found === undefined) return;
    setName(person);
    setGroups((before) => [...new Set([...before, ...found.roles])]);
  };
  return (
    <ConfirmDialog
      isOpen
      onClose={onClose}
      title={t("identity.title")}
      act={t("identity.save")}
      isDisabled={name.trim() === ""}
      onAct={() => {
        if (!hasAccounts) setUserName(name);
        setUserGroups([...groups, ...more.split(",")]);
        return Promise.resolve();
      }}
    >
      {!hasAccounts && persons.length > 0 && (
        <Select label={t("identity.person")} value={persons.some(({ id }) => shortName(id) === name) ? name : ""} options={[{ value: "", name: t("notChosen") }, ...persons.map(({ id }) => ({ value: shortName(id), name: shortName(id) }))]} onChange={choose} />
      )}
      <UserNameField value={name} onChange={setName} hint={t("identity.hint")} autoFocus />
      {known.length > 0 && (
        <fieldset className="form-group">
          <legend>{t("identity.groups")}</legend>
          {known.map((group) => (
            <Checkbox key={group} isSelected={groups.includes(group)} onChange={(isSelected) => setGroups(isSelected ? [...groups, group] : groups.filter((one) => one !== group))}>
              {group}
            </Checkbox>
          ))}
        </fieldset>
      )}
      <Field label={t("identity.more")} hint={t("identity.moreHint")} value={more} onChange={setMore} />
    </ConfirmDialog>
  );
}
