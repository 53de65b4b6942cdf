/** The people at the gloves: a list, and the gloves and gestures of one person. */
import { SearchX, UserPlus, Users } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { useServiceQuery } from "~/api/useServiceQuery";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { Field } from "~/design/Field";
import { ErrorMessage } from "~/design/ErrorMessage";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { useSubscription } from "~/live/hooks";
import { UnknownName } from "~/route/UnknownName";
import { useQueryParameter } from "~/route/queryParameter";
import { useKeys } from "~/shell/keys";
import { addPerson, SERVICE, type Person } from "./people";
import { PersonPanel } from "./PersonPanel";

const NOBODY: readonly Person[] = [];

export function GesturesView() {
  const { t } = useTranslation("people");
  const [requests, setRequests] = useState(0);
  // The revision changes when somebody has changed a person, here or in another browser.
  const revision = `${requests} ${useSubscription<{ revision: string }>("people")?.revision ?? ""}`;
  const [chosen, choose] = useQueryParameter("person");
  const [isAdding, setAdding] = useState(false);
  const loaded = useServiceQuery<Person[]>(SERVICE, "people", { revision });
  const people = loaded.value ?? NOBODY;
  const reload = () => setRequests((before) => before + 1);
  const name = chosen === "" ? (firstByTitle(people)?.name ?? null) : people.some((person) => person.name === chosen) ? chosen : null;
  useKeys([{ key: "n", does: t("add.act"), act: () => setAdding(true) }]);
  return (
    <div className="people">
      <aside className="people__list">
        <h2>{t("title")}</h2>
        {loaded.failure !== null && <ErrorMessage>{loaded.failure}</ErrorMessage>}
        {people.length > 0 && <PeopleTable people={people} name={name} onOpen={choose} />}
        <Button permission="managePeople" icon={<UserPlus aria-hidden size={18} />} onPress={() => setAdding(true)}>
          {t("add.act")}
        </Button>
      </aside>
      <div className="people__place">
        {name !== null ? (
          <PersonPanel key={name} name={name} people={people} revision={revision} onChange={reload} onRemoved={() => { choose(""); reload(); }} />
        ) : (
          loaded.value !== null &&
          (chosen !== "" ? (
            <UnknownName thing="person" name={chosen} parameter="person" />
          ) : (
            <EmptyState
              icon={<Users aria-hidden size={32} />}
              title={t("none.title")}
              act={
                <Button permission="managePeople" kind="main" onPress={() => setAdding(true)}>
                  {t("add.act")}
                </Button>
              }
            >
              {t("none.means")}
            </EmptyState>
          ))
        )}
      </div>
      <AddPerson isOpen={isAdding} onClose={() => setAdding(false)} onAdded={(added) => { choose(added); reload(); }} />
    </div>
  );
}

function PeopleTable({ people, name, onOpen }: { people: readonly Person[]; name: string | null; onOpen: (name: string) => void }) {
  const { t } = useTranslation("people");
  const [find, setFind] = useQueryParameter("find");
  const [sorting, setSorting] = useSorting("person");
  const matching = useMemo(() => {
    const words = find.toLowerCase().split(/\s+/);
    return people.filter((person) => words.every((word) => `${person.name} ${person.title ?? ""} ${glovesOf(person)}`.toLowerCase().includes(word)));
  }, [people, find]);
  const columns: readonly Column<Person>[] = useMemo(
    () => [
      { id: "person", name: t("list.person"), width: "minmax(0, 2fr)", sortBy: titleOf, cell: (person) => <strong>{titleOf(person)}</strong> },
      {
        id: "gloves", name: t("list.gloves"), width: "minmax(0, 1fr)", sortBy: (person) => glovesOf(person) || null,
        cell: (person) => <span className="quiet">{glovesOf(person) || t("wearsNone")}</span>,
      },
    ],
    [t],
  );
  return (
    <>
      <Field label={t("list.find")} value={find} onChange={setFind} type="search" />
      <DataTable
        label={t("title")}
        rows={matching}
        columns={columns}
        keyOf={(person) => person.name}
        nameOf={(person) => `${titleOf(person)}, ${glovesOf(person) || t("wearsNone")}`}
        rowHeight={44}
        sorting={sorting}
        onSort={setSorting}
        view={find}
        openKey={name}
        onOpen={(person) => onOpen(person.name)}
      >
        {matching.length === 0 && <EmptyState icon={<SearchX aria-hidden size={32} />} title={t("list.noMatch")} />}
      </DataTable>
    </>
  );
}

function firstByTitle(people: readonly Person[]): Person | undefined {
  return people.reduce<Person | undefined>(
    (first, person) => (first === undefined || titleOf(person).localeCompare(titleOf(first), undefined, { numeric: true }) < 0 ? person : first),
    undefined,
  );
}

function titleOf(person: Person): string {
  return person.title ?? person.name;
}

function glovesOf(person: Person): string {
  return person.gloves.map(({ glove }) => glove).join(", ");
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
