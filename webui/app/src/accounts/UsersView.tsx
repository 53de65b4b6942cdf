/** The users: a list with search, and roles, sessions and acts of the chosen one. */
import { SearchX, UserPlus, UsersRound } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { RelativeTime } from "~/design/RelativeTime";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { UnknownName } from "~/route/UnknownName";
import { useQueryParameter } from "~/route/queryParameter";
import { useKeys } from "~/shell/keys";
import { useUsers, type UserView } from "./accounts";
import { useGrantWords } from "./GrantList";
import { InviteDialog } from "./Invite";
import { SecretDialog, type Secret } from "./SecretDialog";
import { UserPanel } from "./UserPanel";

export function UsersView() {
  const { t } = useTranslation("accounts");
  const { users, failure, reload } = useUsers();
  const [chosen, choose] = useQueryParameter("user");
  const [isInviting, setInviting] = useState(false);
  const [secret, setSecret] = useState<Secret | null>(null);
  const [note, setNote] = useState<string | null>(null);
  useKeys([{ key: "n", does: t("invite.act"), act: () => setInviting(true) }]);
  const user = users?.find(({ subject }) => subject === chosen);
  return (
    <div className="people">
      <aside className="people__list" aria-label={t("users.title")}>
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        <Button kind="main" icon={<UserPlus aria-hidden size={18} />} onPress={() => setInviting(true)}>
          {t("invite.act")}
        </Button>
        {users !== null && <UsersTable users={users} chosen={chosen} onOpen={choose} />}
      </aside>
      <div className="people__place">
        {note !== null && <p role="status">{note}</p>}
        {user === undefined && chosen !== "" ? (
          users !== null && <UnknownName thing="user" name={chosen} parameter="user" />
        ) : user === undefined ? (
          <EmptyState icon={<UsersRound aria-hidden size={32} />} title={t("users.choose")}>
            {t("users.chooseMeans")}
          </EmptyState>
        ) : (
          <UserPanel
            key={user.subject}
            user={user}
            onChange={reload}
            onSecret={setSecret}
            onDeleted={(remains) => {
              setNote(remains);
              choose("");
              reload();
            }}
          />
        )}
      </div>
      {isInviting && <InviteDialog isOpen onClose={() => setInviting(false)} onLink={setSecret} />}
      <SecretDialog secret={secret} onClose={() => setSecret(null)} />
    </div>
  );
}

function UsersTable({ users, chosen, onOpen }: { users: readonly UserView[]; chosen: string; onOpen: (subject: string) => void }) {
  const { t } = useTranslation("accounts");
  const words = useGrantWords();
  const [find, setFind] = useQueryParameter("find");
  const [sorting, setSorting] = useSorting("user");
  const wordsOf = useMemo(() => new Map(users.map((user) => [user.subject, words(user.grants)])), [users, words]);
  const matching = useMemo(() => {
    const wanted = find.toLowerCase().split(/\s+/);
    return users.filter((user) => wanted.every((word) => `${user.name} ${wordsOf.get(user.subject) ?? ""}`.toLowerCase().includes(word)));
  }, [users, find, wordsOf]);
  const columns: readonly Column<UserView>[] = useMemo(
    () => [
      {
        id: "user", name: t("users.name"), width: "minmax(0, 2fr)", sortBy: ({ name }) => name,
        cell: (user) => (
          <>
            <strong className="cell__name">{user.name}</strong>
            <p className="cell__detail">{wordsOf.get(user.subject)}</p>
          </>
        ),
      },
      {
        id: "seen", name: t("users.seen"), width: "minmax(0, 1fr)", isDescendingFirst: true, sortBy: ({ seenAt }) => seenAt,
        cell: ({ seenAt }) => (seenAt === null ? <span className="quiet">–</span> : <RelativeTime at={seenAt} />),
      },
    ],
    [t, wordsOf],
  );
  return (
    <>
      <Field label={t("users.find")} value={find} onChange={setFind} type="search" />
      <p className="quiet small" role="status">{t("users.count", { count: matching.length })}</p>
      <DataTable
        label={t("users.title")}
        rows={matching}
        columns={columns}
        keyOf={(user) => user.subject}
        nameOf={(user) => `${user.name}, ${wordsOf.get(user.subject) ?? ""}`}
        rowHeight={56}
        sorting={sorting}
        onSort={setSorting}
        view={find}
        openKey={chosen}
        onOpen={(user) => onOpen(user.subject)}
      >
        {matching.length === 0 && <EmptyState icon={<SearchX aria-hidden size={24} />} title={t("users.noMatch")} />}
      </DataTable>
    </>
  );
}
