/** The stations: screens with gloves that people join; who has joined each, how and since when. */
import { MonitorCheck, Plus } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import type { StationView } from "~/api/generated/accounts";
import { request, requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { RelativeTime } from "~/design/RelativeTime";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { useKeys } from "~/shell/keys";
import { SERVICE } from "./accounts";

const REFRESH_MS = 5_000;
interface Act { kind: "use" | "remove"; station: StationView }

export function StationsView() {
  const { t } = useTranslation(["accounts", "common"]);
  const { value, failure, reload } = useServiceQuery<StationView[]>(SERVICE, "stations", { intervalMs: REFRESH_MS });
  const [isAdding, setAdding] = useState(false);
  const [made, setMade] = useState<string>();
  const [act, setAct] = useState<Act | null>(null);
  const [sorting, setSorting] = useSorting("name", "stationSort");
  const columns = useColumns(setAct);
  useKeys([{ key: "n", does: t("stations.add"), act: () => setAdding(true) }]);
  const add = (
    <Button kind="main" icon={<Plus aria-hidden size={18} />} onPress={() => setAdding(true)}>
      {t("stations.add")}
    </Button>
  );
  return (
    <section className="accounts__wide" aria-label={t("stations.title")}>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {value?.length === 0 ? (
        <EmptyState icon={<MonitorCheck aria-hidden size={32} />} title={t("stations.none")} act={add}>
          {t("stations.noneMeans")}
        </EmptyState>
      ) : (
        <>
          <div className="accounts__bar">{add}</div>
          <DataTable
            label={t("stations.title")}
            rows={value ?? []}
            columns={columns}
            keyOf={(station) => station.subject}
            nameOf={(station) => station.name}
            rowHeight={64}
            isLabelled
            sorting={sorting}
            onSort={setSorting}
            made={made}
          />
        </>
      )}
      {isAdding && <AddDialog onClose={() => setAdding(false)} onAdded={({ subject }) => { setMade(subject); reload(); }} />}
      <ConfirmDialog
        isOpen={act?.kind === "use"}
        onClose={() => setAct(null)}
        title={t("stations.useTitle", { name: act?.station.name ?? "" })}
        act={t("stations.use")}
        onAct={async () => {
          await request("session/station", { method: "POST", json: { station: act?.station.subject } });
          location.replace("/work");
        }}
      >
        <p>{t("stations.useMeans")}</p>
      </ConfirmDialog>
      <ConfirmDialog
        isOpen={act?.kind === "remove"}
        onClose={() => setAct(null)}
        kind="stop"
        title={t("stations.removeTitle", { name: act?.station.name ?? "" })}
        act={t("stations.remove")}
        onAct={() => requestService(SERVICE, `stations/${encodeURIComponent(act?.station.subject ?? "")}`, { method: "DELETE" }).finally(reload)}
      >
        <p>{t("stations.removeMeans")}</p>
      </ConfirmDialog>
    </section>
  );
}

function useColumns(onAct: (act: Act) => void): readonly Column<StationView>[] {
  const { t } = useTranslation(["accounts", "common"]);
  return useMemo(
    () => [
      {
        id: "name", name: t("stations.name"), width: "minmax(140px, 1.5fr)", sortBy: ({ name }) => name,
        cell: ({ name, gloves }) => (
          <>
            <strong className="cell__name">{name}</strong>
            <p className="cell__detail">{gloves.length === 0 ? t("stations.noGloves") : gloves.join(", ")}</p>
          </>
        ),
      },
      {
        id: "joined", name: t("stations.joined"), width: "minmax(160px, 1.5fr)", sortBy: ({ joined }) => joined?.name ?? null,
        cell: ({ joined }) =>
          joined === null ? (
            <span className="quiet">{t("stations.nobody")}</span>
          ) : (
            <>
              <span className="cell__name">{joined.name}</span>
              <p className="cell__detail">
                {t("common:station.by", { method: t(`common:station.methods.${joined.method}`, { defaultValue: joined.method }) })} · <RelativeTime at={joined.since} />
              </p>
            </>
          ),
      },
      { id: "screens", name: t("stations.screens"), width: "minmax(90px, 0.7fr)", isNumber: true, isDescendingFirst: true, sortBy: ({ sessions }) => sessions, cell: ({ sessions }) => sessions },
      { id: "leaves", name: t("stations.leavesAfter"), width: "minmax(110px, 0.9fr)", isNumber: true, sortBy: ({ leaveAfterMin }) => leaveAfterMin, cell: ({ leaveAfterMin }) => t("stations.minutes", { count: leaveAfterMin }) },
      {
        id: "acts", name: "", width: "minmax(220px, 1.5fr)",
        cell: (station) => (
          <div className="accounts__acts">
            <Button label={t("stations.useOne", { name: station.name })} onPress={() => onAct({ kind: "use", station })}>
              {t("stations.use")}
            </Button>
            <Button kind="quiet" label={t("stations.removeOne", { name: station.name })} onPress={() => onAct({ kind: "remove", station })}>
              {t("stations.remove")}
            </Button>
          </div>
        ),
      },
    ],
    [t, onAct],
  );
}

function AddDialog({ onClose, onAdded }: { onClose: () => void; onAdded: (station: StationView) => void }) {
  const { t } = useTranslation("accounts");
  const [name, setName] = useState("");
  const [gloves, setGloves] = useState("");
  const [minutes, setMinutes] = useState("15");
  const leaveAfterMin = Number(minutes);
  const isUsable = name.trim().length >= 2 && leaveAfterMin > 0 && leaveAfterMin <= 1440;
  return (
    <ConfirmDialog
      isOpen
      onClose={onClose}
      title={t("stations.add")}
      act={t("stations.add")}
      isDisabled={!isUsable}
      onAct={() =>
        requestService<StationView>(SERVICE, "stations", {
          method: "POST",
          json: { name: name.trim(), gloves: gloves.split(/[\s,]+/).filter((glove) => glove !== ""), leaveAfterMin },
        }).then(onAdded)
      }
    >
      <Field label={t("stations.name")} value={name} onChange={setName} maxLength={64} autoFocus />
      <Field label={t("stations.gloves")} hint={t("stations.glovesHint")} value={gloves} onChange={setGloves} />
      <Field label={t("stations.leavesAfter")} hint={t("stations.leavesHint")} type="number" inputMode="decimal" value={minutes} onChange={setMinutes} />
    </ConfirmDialog>
  );
}
