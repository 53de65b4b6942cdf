/** A user: roles and what they are for, the Person of the cell, sessions, a link for a new password, deletion. */
import { KeyRound, Plus, Trash2 } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { Checkbox } from "~/design/Checkbox";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Select } from "~/design/Select";
import { localizedText } from "~/i18n/server";
import { shortName } from "~/live/urn";
import { useSession } from "~/session/session";
import { addGrants, deleteUser, makePasswordLink, removeGrant, removePerson, setPerson, type UserView } from "./accounts";
import { GrantForm } from "./GrantForm";
import { GrantList } from "./GrantList";
import { grantsOf, NEW_DRAFT, useResources } from "./grants";
import { Identifiers } from "./Identifiers";
import { useLinkSecret } from "./Invite";
import type { Secret } from "./SecretDialog";
import { Sessions } from "./Sessions";

export interface UserPanelProps {
  user: UserView;
  onChange: () => void;
  onSecret: (secret: Secret) => void;
  onDeleted: (remains: string) => void;
}

export function UserPanel({ user, onChange, onSecret, onDeleted }: UserPanelProps) {
  const { t } = useTranslation("accounts");
  const secretOf = useLinkSecret();
  const me = useSession().user;
  const [failure, setFailure] = useState<string | null>(null);
  const [isAdding, setAdding] = useState(false);
  const [isDeleting, setDeleting] = useState(false);
  const act = async (action: Promise<unknown>) => {
    setFailure(null);
    try {
      await action;
    } catch (error) {
      setFailure(errorText(error));
    }
    onChange();
  };
  return (
    <>
      <header className="people__head">
        <h2>{user.name}</h2>
        {me?.subject === user.subject && <span className="quiet">{t("users.you")}</span>}
        <span className="people__profile">
          <Button icon={<KeyRound aria-hidden size={18} />} onPress={() => void act(makePasswordLink(user.subject).then((link) => onSecret(secretOf(link, "password"))))}>
            {t("users.passwordLink")}
          </Button>
          <Button kind="quiet" icon={<Trash2 aria-hidden size={18} />} onPress={() => setDeleting(true)}>
            {t("users.delete")}
          </Button>
        </span>
      </header>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <Card
        title={t("grants.title")}
        aside={
          <Button icon={<Plus aria-hidden size={18} />} onPress={() => setAdding(true)}>
            {t("grants.add")}
          </Button>
        }
      >
        <GrantList grants={user.grants} onRemove={(grant) => void act(removeGrant(grant.id))} />
      </Card>
      <Sessions path={`users/${encodeURIComponent(user.subject)}/sessions`} endAll={t("sessions.endAll")} onEnded={onChange} />
      <Identifiers user={user} onSecret={onSecret} />
      <Card title={t("users.person")}>
        <p className="quiet">{t("users.personMeans")}</p>
        <PersonSelect user={user} onChange={(person) => void act(setPerson(user.subject, person))} />
      </Card>
      {isAdding && <AddGrant user={user} onClose={() => setAdding(false)} onAdded={onChange} />}
      {isDeleting && <DeleteUser user={user} onClose={() => setDeleting(false)} onDeleted={onDeleted} />}
    </>
  );
}

function DeleteUser({ user, onClose, onDeleted }: { user: UserView; onClose: () => void; onDeleted: (remains: string) => void }) {
  const { t } = useTranslation("accounts");
  const [withPerson, setWithPerson] = useState(false);
  const { person } = user;
  const removed = async () => {
    if (person === null || !withPerson) return [];
    const { parts, remains } = await removePerson(person);
    const kept = parts.filter(({ outcome }) => outcome === "refused" || outcome === "unreachable");
    return [
      t("users.personDeleted", { person: shortName(person) }),
      ...kept.map(({ service, detail }) => t("users.partRemains", { service, detail: detail ?? "" })),
      ...remains.flatMap((one) => localizedText(one, "why") ?? []),
    ];
  };
  const remove = async () => {
    const ofPerson = await removed(); // first, since it can be repeated while the account names the person
    const [records, ...others] = (await deleteUser(user.subject)).remains;
    const left = withPerson ? ofPerson : others.map(({ what }) => t("users.personRemains", { person: shortName(what) }));
    onDeleted([t("users.deleted", { name: user.name, count: records?.count ?? 0 }), ...left].join(" "));
  };
  return (
    <ConfirmDialog isOpen onClose={onClose} kind="stop" title={t("users.deleteTitle", { name: user.name })} act={t("users.delete")} onAct={remove}>
      <p>{t("users.deleteMeans")}</p>
      {person !== null && (
        <Checkbox isSelected={withPerson} onChange={setWithPerson}>
          {t("users.deletePerson", { person: shortName(person) })}
        </Checkbox>
      )}
    </ConfirmDialog>
  );
}

function AddGrant({ user, onClose, onAdded }: { user: UserView; onClose: () => void; onAdded: () => void }) {
  const { t } = useTranslation("accounts");
  const [draft, setDraft] = useState(NEW_DRAFT);
  const grants = grantsOf(draft);
  return (
    <ConfirmDialog
      isOpen
      onClose={onClose}
      title={t("grants.addTo", { name: user.name })}
      act={t("grants.add")}
      isDisabled={grants.length === 0}
      onAct={() => addGrants(user.subject, grants).finally(onAdded)}
    >
      <GrantForm draft={draft} onChange={setDraft} />
    </ConfirmDialog>
  );
}

function PersonSelect({ user, onChange }: { user: UserView; onChange: (person: string | null) => void }) {
  const { t } = useTranslation("accounts");
  const { resources } = useResources();
  const people = resources.filter(({ kind }) => kind === "Person").map(({ id, name }) => ({ value: id, name }));
  const isListed = user.person === null || people.some(({ value }) => value === user.person);
  const present = isListed ? [] : [{ value: user.person ?? "", name: shortName(user.person ?? "") }];
  return (
    <Select
      label={t("users.person")}
      value={user.person ?? ""}
      options={[{ value: "", name: t("users.noPerson") }, ...present, ...people]}
      onChange={(person) => onChange(person === "" ? null : person)}
    />
  );
}
