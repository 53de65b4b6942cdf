/** A list of rules, channels or routes, and beside it the one that is open. */
import { ArrowLeft, Plus, SearchX } from "lucide-react";
import { useMemo, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { Loading } from "~/design/Loading";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { useChoice } from "~/route/choice";
import { UnknownName } from "~/route/UnknownName";
import { useQueryChange, useQueryParameter } from "~/route/queryParameter";
import { useKeys } from "~/shell/keys";

interface Named {
  name: string;
  source: string;
}

export interface SettingsViewProps<T extends Named> {
  /** The view: `rules`, `channels` or `routes`. */
  kind: "rules" | "channels" | "routes";
  icon: ReactNode;
  rows: readonly T[] | null;
  failure: string | null;
  mayAdd: boolean;
  /** What is said under the name. */
  detailOf: (row: T) => string;
  stateOf: (row: T) => { word: string; badge: ReactNode };
  /** The form of a row, or of a new one; `onDone` opens the named one, or the list. */
  show: (row: T | null, onDone: (name: string) => void) => ReactNode;
}

export function SettingsView<T extends Named>({ kind, icon, rows, failure, mayAdd, detailOf, stateOf, show }: SettingsViewProps<T>) {
  const { t } = useTranslation(["alerting", "common"]);
  const [chosen] = useQueryParameter("name");
  const [adding] = useChoice("add", ["", "yes"], "");
  const [find, setFind] = useQueryParameter("find");
  const change = useQueryChange();
  const [sorting, setSorting] = useSorting("name");
  const isAdding = adding === "yes" && mayAdd;
  const open = (name: string) => change({ add: "", name });
  const add = () => change({ add: "yes", name: "" });
  useKeys(mayAdd ? [{ key: "n", does: t(`${kind}.add`), act: add }] : []);
  const row = rows?.find(({ name }) => name === chosen) ?? null;
  const shown = useMemo(() => (rows ?? []).filter((one) => `${one.name} ${detailOf(one)}`.toLowerCase().includes(find.toLowerCase())), [rows, find, detailOf]);
  const columns: readonly Column<T>[] = useMemo(
    () => [
      {
        id: "name", name: t("list.name"), width: "minmax(0, 1fr)", sortBy: ({ name }) => name,
        cell: (one) => (
          <>
            <strong className="cell__name">{one.name}</strong>
            <p className="cell__detail">{detailOf(one)}</p>
          </>
        ),
      },
      { id: "state", name: t("list.state"), width: "auto", sortBy: (one) => stateOf(one).word, cell: (one) => stateOf(one).badge },
    ],
    [t, detailOf, stateOf],
  );
  const addButton = mayAdd && (
    <Button kind="main" icon={<Plus aria-hidden size={18} />} onPress={add} isDisabled={isAdding}>
      {t(`${kind}.add`)}
    </Button>
  );
  const isOpen = isAdding || row !== null;
  return (
    <div className="alerting" data-open={isOpen || undefined}>
      <aside className="alerting__list" aria-label={t(`view.${kind}`)}>
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        {rows !== null && rows.length > 0 && (
          <>
            {addButton}
            <Field label={t("list.find")} value={find} onChange={setFind} type="search" />
            <DataTable
              label={t(`view.${kind}`)}
              rows={shown}
              columns={columns}
              keyOf={({ name }) => name}
              nameOf={(one) => `${one.name}, ${detailOf(one)}, ${stateOf(one).word}`}
              rowHeight={60}
              sorting={sorting}
              onSort={setSorting}
              view={find}
              openKey={isAdding ? null : chosen}
              onOpen={({ name }) => open(name)}
              isCompact
            >
              {shown.length === 0 && <EmptyState icon={<SearchX aria-hidden size={24} />} title={t("list.noMatch")} />}
            </DataTable>
          </>
        )}
        {rows === null && failure === null && <Loading />}
      </aside>
      <div className="alerting__place">
        {isOpen ? (
          <Card title={row === null ? t(`${kind}.add`) : row.name} aside={<Button kind="quiet" icon={<ArrowLeft aria-hidden size={18} />} onPress={() => open("")}>{t("list.back")}</Button>}>
            <div className="alerting__content" key={isAdding ? "" : row?.name}>{show(isAdding ? null : row, open)}</div>
          </Card>
        ) : (
          rows !== null &&
          (chosen !== "" ? (
            <UnknownName thing="value" name={chosen} parameter="name" />
          ) : (
            <EmptyState icon={icon} title={rows.length === 0 ? t(`${kind}.none`) : t(`${kind}.choose`)} act={rows.length === 0 ? addButton : undefined}>
              {t(`${kind}.means`)}
            </EmptyState>
          ))
        )}
      </div>
    </div>
  );
}
