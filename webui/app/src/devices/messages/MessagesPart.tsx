/** All messages that a device sent and received, newest first; older ones load at the end of the table. */
import { ArrowDownLeft, ArrowUpRight, SearchX } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import type { MessageView } from "~/api/generated/device-gateway";
import { errorText, requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { RelativeTime } from "~/design/RelativeTime";
import { SegmentedControl } from "~/design/SegmentedControl";
import { Select } from "~/design/Select";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useChoice } from "~/route/choice";
import { useQueryParameter } from "~/route/queryParameter";
import { pathOf, SERVICE } from "../gateway";
import { isoOf } from "../values";

const PAGE = 100;
const DIRECTIONS = ["all", "in", "out"] as const;
const REFRESH_MS = 2000;
const TYPES = ["telemetry", "state", "event", "command", "ack", "error", "refused"];
const UNSORTED = { by: "", isDescending: false };

export function MessagesPart({ device }: { device: string }) {
  const { t } = useTranslation("devices");
  const [direction, setDirection] = useChoice("direction", DIRECTIONS, "all");
  const [type, setType] = useQueryParameter("type");
  const query = `${direction === "all" ? "" : `&direction=${direction}`}${type === "" ? "" : `&type=${encodeURIComponent(type)}`}`;
  return (
    <div className="device__messages">
      <div className="device__filters">
        <SegmentedControl
          label={t("messages.direction")}
          value={direction}
          options={DIRECTIONS.map((value) => ({ value, name: t(`messages.${value}`) }))}
          onChange={setDirection}
        />
        <Select label={t("messages.type")} value={type} options={[{ value: "", name: t("messages.allTypes") }, ...TYPES.map((value) => ({ value, name: t(`messageType.${value}`) }))]} onChange={setType} />
      </div>
      <Messages key={`${device} ${query}`} path={`${pathOf(device)}/messages?limit=${PAGE}${query}`} />
    </div>
  );
}

function Messages({ path }: { path: string }) {
  const { t } = useTranslation("devices");
  const { value: newest, failure } = useServiceQuery<MessageView[]>(SERVICE, path, { intervalMs: REFRESH_MS });
  const [kept, setKept] = useState<ReadonlyMap<number, MessageView>>(new Map());
  const [older, setOlder] = useState<{ isLoading: boolean; isAll: boolean; failure: string | null }>({ isLoading: false, isAll: false, failure: null });
  // Each answer adds to what is known, so that the table does not lose rows that somebody reads.
  const isKnown = newest === null || newest.every(({ number }) => kept.has(number));
  if (!isKnown) setKept(merged(kept, newest));
  const rows = useMemo(() => [...kept.values()].sort((a, b) => b.number - a.number), [kept]);
  const columns = useColumns();
  const loadOlder = () => {
    const last = rows.at(-1);
    if (last === undefined || rows.length < PAGE || older.isLoading || older.isAll || older.failure !== null) return;
    setOlder({ isLoading: true, isAll: false, failure: null });
    requestService<MessageView[]>(SERVICE, `${path}&before=${last.number}`).then(
      (found) => {
        setKept((before) => merged(before, found));
        setOlder({ isLoading: false, isAll: found.length < PAGE, failure: null });
      },
      (error: unknown) => setOlder({ isLoading: false, isAll: false, failure: errorText(error) }),
    );
  };
  const fault = failure ?? older.failure;
  return (
    <>
      {fault !== null && <ErrorMessage>{fault}</ErrorMessage>}
      <DataTable label={t("part.messages")} rows={rows} columns={columns} keyOf={(row) => String(row.number)} rowHeight={44} sorting={UNSORTED} onSort={() => undefined} onEnd={loadOlder}>
        {newest !== null && rows.length === 0 && <EmptyState icon={<SearchX aria-hidden size={32} />} title={t("messages.none")} />}
      </DataTable>
    </>
  );
}

function merged(before: ReadonlyMap<number, MessageView>, news: readonly MessageView[]): ReadonlyMap<number, MessageView> {
  return new Map([...before, ...news.map((message) => [message.number, message] as const)]);
}

function useColumns(): readonly Column<MessageView>[] {
  const { t } = useTranslation("devices");
  return useMemo(
    () => [
      { id: "at", name: t("messages.at"), width: "110px", cell: (row) => <RelativeTime at={isoOf(row.at)} /> },
      {
        id: "direction", name: t("messages.direction"), width: "130px",
        cell: (row) => (
          <span className="message-direction">
            {row.direction === "in" ? <ArrowDownLeft aria-hidden size={16} /> : <ArrowUpRight aria-hidden size={16} />}
            {t(row.direction === "in" ? "messages.in" : "messages.out")}
          </span>
        ),
      },
      { id: "type", name: t("messages.type"), width: "120px", cell: (row) => t(`messageType.${row.type}`, { defaultValue: row.type }) },
      { id: "message", name: t("messages.message"), width: "minmax(0, 1fr)", cell: (row) => <code className="message-text">{typeof row.message === "string" ? row.message : JSON.stringify(row.message)}</code> },
      { id: "answer", name: t("messages.answer"), width: "minmax(0, 0.4fr)", cell: (row) => row.answer },
    ],
    [t],
  );
}
