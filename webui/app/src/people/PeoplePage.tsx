/** People and gestures: who works here, who wears which glove, and which gesture is whose. */
import { UserPlus, Users } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { useAsked } from "~/api/useAsked";
import { Ask } from "~/design/Ask";
import { Button } from "~/design/Button";
import { Empty } from "~/design/Empty";
import { Field } from "~/design/Field";
import { Problem } from "~/design/Problem";
import { useWanted } from "~/live/hooks";
import { useQuery } from "~/route/query";
import { useKeys } from "~/shell/keys";
import { addPerson, SERVICE, type Person } from "./people";
import { PersonPanel } from "./PersonPanel";
import "./PeoplePage.css";

export default function PeoplePage() {
  const { t } = useTranslation("people");
  const [asks, setAsks] = useState(0);
  // Another revision: somebody has changed something, here or in another browser.
  const revision = useWanted<{ revision: string }>("people")?.revision ?? "";
  const turn = `${asks} ${revision}`;
  const [chosen, choose] = useQuery("person");
  const [isAdding, setAdding] = useState(false);
  const everybody = useAsked<Person[]>(SERVICE, "people", turn);
  const again = () => setAsks((before) => before + 1);
  const name = everybody.value?.some((one) => one.name === chosen) === true ? chosen : (everybody.value?.[0]?.name ?? null);
  useKeys([{ key: "n", does: t("add.act"), act: () => setAdding(true) }]);
  return (
    <div className="people">
      <aside className="people__list">
        <h1>{t("title")}</h1>
        {everybody.failure !== null && <Problem>{everybody.failure}</Problem>}
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
            <Empty
              icon={<Users aria-hidden size={32} />}
              title={t("none.title")}
              act={
                <Button kind="main" onPress={() => setAdding(true)}>
                  {t("add.act")}
                </Button>
              }
            >
              {t("none.means")}
            </Empty>
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
    <Ask
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
    </Ask>
  );
}
