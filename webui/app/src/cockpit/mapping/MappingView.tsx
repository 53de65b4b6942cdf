/** Mapping: which names in process files stand for which performers. A person confirms each version. */
import { Pencil, Plus, Trash2 } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import type { MappingEntry, MappingRequest, MappingUse, MappingView as Mapping, UsedNameView } from "~/api/generated/task-orchestrator";
import { ApiError, requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { localizedText } from "~/i18n/server";
import { MayNot } from "~/design/MayNot";
import { useWithName } from "~/shell/userName";
import { useAgents } from "../agents/AgentsView";
import { EntryDialog } from "./EntryDialog";
import { applied, draftOf, keyOf, NO_CHANGES, targetOf, unmapped, valueOf, withChange, type Changes, type Draft } from "./mapping";

const SERVICE = "task-orchestrator";
const REFRESH_MS = 10_000;

interface Opened {
  draft: Draft;
  before: MappingEntry | null;
}

export function MappingView() {
  const { t } = useTranslation("cockpit");
  const mapping = useServiceQuery<Mapping>(SERVICE, "mapping", { intervalMs: REFRESH_MS });
  const use = useServiceQuery<MappingUse>(SERVICE, "mapping/names", { intervalMs: REFRESH_MS });
  const agents = useAgents().value ?? [];
  const [changes, setChanges] = useState<Changes>(NO_CHANGES);
  /** The version that the changes were made to. */
  const [base, setBase] = useState<number | null>(null);
  const [opened, setOpened] = useState<Opened | null>(null);
  const present = mapping.value;
  const entries = useMemo(() => applied(present?.entries ?? [], changes), [present, changes]);
  const change = (before: MappingEntry | null, after: MappingEntry | null) => {
    setBase((known) => known ?? present?.version ?? 0);
    setChanges((all) => withChange(all, before, after));
  };
  const reset = () => {
    setChanges(NO_CHANGES);
    setBase(null);
  };
  const failure = mapping.failure ?? use.failure;
  const open = (draft: Draft, before: MappingEntry | null) => setOpened({ draft, before });
  return (
    <section className="cockpit__section" aria-label={t("view.mapping")}>
      {failure !== null && <ErrorMessage>{t("unread", { why: failure })}</ErrorMessage>}
      <MayNot permission="deployProcesses" />
      {present !== null && (
        <Confirmation
          mapping={present}
          base={base ?? present.version}
          entries={entries}
          isChanged={changes.size > 0}
          onBase={() => setBase(present.version)}
          onConflict={mapping.reload}
          onReset={reset}
          onConfirmed={() => {
            reset();
            mapping.reload();
            use.reload();
          }}
        />
      )}
      <div className="cockpit__columns">
        <Card
          title={t("mapping.entries")}
          aside={
            <Button permission="deployProcesses" icon={<Plus aria-hidden size={16} />} onPress={() => open({ kind: "topic", name: "", target: "resource", value: "", definition: "", parameters: "" }, null)}>
              {t("mapping.add")}
            </Button>
          }
        >
          <Entries entries={entries} use={use.value} onOpen={(entry) => open(draftOf(entry), entry)} onRemove={(entry) => change(entry, null)} />
        </Card>
        <Card title={t("mapping.unmapped")}>
          <p className="quiet small cockpit__note">{t("mapping.unmappedMeans")}</p>
          <Unmapped
            names={unmapped(use.value?.names ?? [], entries)}
            isLoaded={use.value !== null}
            onMap={({ kind, name }) => open({ kind, name, target: "resource", value: "", definition: "", parameters: "" }, null)}
          />
        </Card>
      </div>
      {opened !== null && (
        <EntryDialog
          initial={opened.draft}
          isNew={opened.before === null}
          agents={agents}
          onClose={() => setOpened(null)}
          onEntry={(entry) => change(opened.before, entry)}
        />
      )}
    </section>
  );
}

interface ConfirmationProps {
  mapping: Mapping;
  base: number;
  entries: readonly MappingEntry[];
  isChanged: boolean;
  onBase: () => void;
  /** The mapping is another one than was read. */
  onConflict: () => void;
  onReset: () => void;
  onConfirmed: () => void;
}

function Confirmation({ mapping, base, entries, isChanged, onBase, onConflict, onReset, onConfirmed }: ConfirmationProps) {
  const { t } = useTranslation("cockpit");
  const { withName, question } = useWithName();
  const [asks, setAsks] = useState(false);
  const [why, setWhy] = useState("");
  const [hasConflict, setConflict] = useState(false);
  const isOld = hasConflict || base !== mapping.version;
  const confirm = () =>
    withName((by) => {
      const json: MappingRequest = { by, version: base, entries: [...entries], ...(why.trim() === "" ? {} : { why: why.trim() }) };
      return requestService<Mapping>(SERVICE, "mapping", { method: "PUT", json }).then(
        () => {
          setConflict(false);
          setWhy("");
          onConfirmed();
        },
        (error: unknown) => {
          const isConflict = error instanceof ApiError && error.problem.status === 409;
          setConflict(isConflict);
          if (isConflict) onConflict();
          throw error;
        },
      );
    });
  return (
    <div className="mapping__state">
      {mapping.by === null ? (
        <StatusBadge tone="attention">{t(mapping.version === 0 ? "mapping.empty" : "mapping.unconfirmed")}</StatusBadge>
      ) : (
        <StatusBadge tone="ok">{t("mapping.confirmed", { version: mapping.version, by: mapping.by })}</StatusBadge>
      )}
      {mapping.at !== null && <RelativeTime at={mapping.at} isStop />}
      {mapping.why !== null && <span className="quiet">{mapping.why}</span>}
      {isChanged && <StatusBadge tone="accent">{t("mapping.changed")}</StatusBadge>}
      {isOld && (
        <div className="mapping__conflict">
          <ErrorMessage>{t("mapping.conflict", { present: mapping.version, base })}</ErrorMessage>
          <Button
            isDisabled={base === mapping.version}
            onPress={() => {
              setConflict(false);
              onBase();
            }}
          >
            {t("mapping.takeOver")}
          </Button>
        </div>
      )}
      <span className="mapping__acts">
        {isChanged && <Button onPress={onReset}>{t("mapping.reset")}</Button>}
        {(isChanged || (mapping.by === null && entries.length > 0)) && (
          <Button permission="deployProcesses" kind="main" isDisabled={isOld} onPress={() => setAsks(true)}>
            {t("mapping.confirm")}
          </Button>
        )}
      </span>
      <ConfirmDialog isOpen={asks} onClose={() => setAsks(false)} title={t("mapping.confirmTitle")} act={t("mapping.confirm")} onAct={confirm}>
        <p>{t("mapping.confirmMeans", { count: entries.length })}</p>
        <Field label={t("mapping.why")} value={why} onChange={setWhy} maxLength={1000} />
      </ConfirmDialog>
      {question}
    </div>
  );
}

interface EntriesProps {
  entries: readonly MappingEntry[];
  use: MappingUse | null;
  onOpen: (entry: MappingEntry) => void;
  onRemove: (entry: MappingEntry) => void;
}

function Entries({ entries, use, onOpen, onRemove }: EntriesProps) {
  const { t } = useTranslation("cockpit");
  const [sorting, setSorting] = useSorting("kind", "mappingSort");
  const columns: readonly Column<MappingEntry>[] = useMemo(() => {
    const missing = new Map((use?.missing ?? []).map((one) => [keyOf(one), localizedText(one, "warning")]));
    const uses = new Map((use?.names ?? []).map((one) => [keyOf(one), one.activities.length]));
    return [
      { id: "kind", name: t("mapping.kind"), width: "minmax(100px, 1fr)", sortBy: (entry) => t(`mapping.kinds.${entry.kind}`), cell: (entry) => <span>{t(`mapping.kinds.${entry.kind}`)}</span> },
      { id: "name", name: t("mapping.name"), width: "minmax(120px, 1.6fr)", sortBy: (entry) => entry.name, cell: (entry) => <span className="cell__name">{entry.name}</span> },
      {
        id: "performer", name: t("mapping.performer"), width: "minmax(140px, 1.8fr)", sortBy: valueOf,
        cell: (entry) => (
          <>
            <span>{t("mapping.goesTo", { target: t(`mapping.targets.${targetOf(entry)}`), value: valueOf(entry) })}</span>
            {missing.get(keyOf(entry)) != null && (
              <p>
                <StatusBadge tone="attention">{missing.get(keyOf(entry))}</StatusBadge>
              </p>
            )}
            {entry.definition != null && <p className="cell__detail">{entry.definition}</p>}
          </>
        ),
      },
      { id: "uses", name: t("mapping.uses"), width: "minmax(72px, 0.6fr)", isNumber: true, sortBy: (entry) => uses.get(keyOf(entry)) ?? 0, cell: (entry) => <span>{uses.get(keyOf(entry)) ?? 0}</span> },
      {
        id: "acts", name: t("mapping.acts"), width: "96px",
        cell: (entry) => (
          <span className="mapping__row-acts">
            <Button permission="deployProcesses" kind="quiet" label={t("mapping.changeOne", { name: entry.name })} icon={<Pencil aria-hidden size={16} />} onPress={() => onOpen(entry)} />
            <Button permission="deployProcesses" kind="quiet" label={t("mapping.removeOne", { name: entry.name })} icon={<Trash2 aria-hidden size={16} />} onPress={() => onRemove(entry)} />
          </span>
        ),
      },
    ];
  }, [t, use, onOpen, onRemove]);
  if (entries.length === 0) return <EmptyState title={t("mapping.none")}>{t("mapping.noneMeans")}</EmptyState>;
  return <DataTable label={t("mapping.entries")} rows={entries} columns={columns} keyOf={keyOf} nameOf={(entry) => entry.name} rowHeight={48} isLabelled isCompact sorting={sorting} onSort={setSorting} onOpen={onOpen} />;
}

function Unmapped({ names, isLoaded, onMap }: { names: readonly UsedNameView[]; isLoaded: boolean; onMap: (used: UsedNameView) => void }) {
  const { t } = useTranslation("cockpit");
  const [sorting, setSorting] = useSorting("kind", "unmappedSort");
  const columns: readonly Column<UsedNameView>[] = useMemo(
    () => [
      { id: "kind", name: t("mapping.kind"), width: "minmax(100px, 1fr)", sortBy: (used) => t(`mapping.kinds.${used.kind}`), cell: (used) => <span>{t(`mapping.kinds.${used.kind}`)}</span> },
      { id: "name", name: t("mapping.name"), width: "minmax(120px, 1.6fr)", sortBy: (used) => used.name, cell: (used) => <span className="cell__name">{used.name}</span> },
      {
        id: "activities", name: t("mapping.activities"), width: "minmax(160px, 2.2fr)", isDescendingFirst: true, sortBy: (used) => used.activities.length,
        cell: (used) => (
          <span>
            {used.activities.slice(0, 3).map((one) => `${one.definition}: ${one.name === "" ? one.element : one.name}`).join(", ")}
            {used.activities.length > 3 && ` ${t("agents.more", { count: used.activities.length - 3 })}`}
          </span>
        ),
      },
      { id: "acts", name: t("mapping.acts"), width: "110px", cell: (used) => <Button permission="deployProcesses" onPress={() => onMap(used)} aria-label={t("mapping.mapOne", { name: used.name })}>{t("mapping.map")}</Button> },
    ],
    [t, onMap],
  );
  if (isLoaded && names.length === 0) return <p className="quiet">{t("mapping.allMapped")}</p>;
  return <DataTable label={t("mapping.unmapped")} rows={names} columns={columns} keyOf={keyOf} nameOf={(used) => used.name} rowHeight={48} isLabelled isCompact sorting={sorting} onSort={setSorting} onOpen={onMap} />;
}
