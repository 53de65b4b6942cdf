/** People and gestures: who works here, who wears which glove, and which gesture is whose. */
import { UserPlus, Users } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { useServiceQuery } from "~/api/useServiceQuery";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { Field } from "~/design/Field";
import { ErrorMessage } from "~/design/ErrorMessage";
import { useSubscription } from "~/live/hooks";
import { useQueryParameter } from "~/route/queryParameter";
import { useKeys } from "~/shell/keys";
import { addPerson, SERVICE, type Person } from "./people";
import { PersonPanel } from "./PersonPanel";
import "./PeoplePage.css";

export default function PeoplePage() {
  const { t } = useTranslation("people");
  const [asks, setAsks] = useState(0);
  // Another revision: somebody has changed something, here or in another browser.
  const revision = useSubscription<{ revision: string }>("people")?.revision ?? "";
  const turn = `${asks} ${revision}`;
  const [chosen, choose] = useQueryParameter("person");
  const [isAdding, setAdding] = useState(false);
  const everybody = useServiceQuery<Person[]>(SERVICE, "people", { revision: turn });
  const again = () => setAsks((before) => before + 1);
  const name = everybody.value?.some((one) => one.name === chosen) === true ? chosen : (everybody.value?.[0]?.name ?? null);
  useKeys([{ key: "n", does: t("add.act"), act: () => setAdding(true) }]);
  return (
    <div className="people">
      <aside className="people__list">
        <h1>{t("title")}</h1>
        {everybody.failure !== null && <ErrorMessage>{everybody.failure}</ErrorMessage>}
        <ul>
          {(everybody.value ?? []).map((person) => (
            <li key={person.name}>
              <button type="button" className="people__person" aria-current={person.name === name || undefined} onClick={() => choose(person.name)}>
                <strong>{person.title ?? person.name}</strong>
                <span className="quiet">{person.gloves.map(({ glove }) => glove).join(", ") || t("wearsNone")}</span>
              </button>
            </li>
          ))}
        </ul>
        <Button icon={<UserPlus aria-hidden size={18} />} onPress={() => setAdding(true)}>
          {t("add.act")}
        </Button>
      </aside>
      <div className="people__place">
        {name !== null ? (
          <PersonPanel key={name} name={name} people={everybody.value ?? []} turn={turn} onChange={again} onGone={() => { choose(""); again(); }} />
        ) : (
          everybody.value !== null && (
            <EmptyState
              icon={<Users aria-hidden size={32} />}
              title={t("none.title")}
              act={
                <Button kind="main" onPress={() => setAdding(true)}>
                  {t("add.act")}
                </Button>
              }
            >
              {t("none.means")}
            </EmptyState>
          )
        )}
      </div>
      <AddPerson isOpen={isAdding} onClose={() => setAdding(false)} onAdded={(added) => { choose(added); again(); }} />
    </div>
  );
}

function AddPerson({ isOpen, onClose, onAdded }: { isOpen: boolean; onClose: () => void; onAdded: (name: string) => void }) {
  const { t } = useTranslation("people");
  const [name, setName] = useState("");
  const [title, setTitle] = useState("");
  const close = () => {
    setName("");
    setTitle("");
    onClose();
  };
  return (
    <ConfirmDialog
      isOpen={isOpen}
      onClose={close}
      title={t("add.title")}
      act={t("add.act")}
      isDisabled={name.trim() === ""}
      onAct={async () => {
        await addPerson(name.trim(), title.trim());
        onAdded(name.trim());
      }}
    >
      <Field label={t("add.name")} hint={t("add.nameHint")} value={name} onChange={setName} autoFocus />
      <Field label={t("add.called")} value={title} onChange={setTitle} />
    </ConfirmDialog>
  );
}
