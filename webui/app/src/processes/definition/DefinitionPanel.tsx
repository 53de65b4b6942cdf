/** A definition: its diagram with what became of all its processes, its versions, and a way to start one. */
import { Download, Play } from "lucide-react";
import { lazy, Suspense, useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { download } from "~/api/download";
import { callService, describe } from "~/api/http";
import { useAsked } from "~/api/useAsked";
import { Ago } from "~/design/Ago";
import { Button } from "~/design/Button";
import { Empty } from "~/design/Empty";
import { Pick } from "~/design/Pick";
import { Problem } from "~/design/Problem";
import { State } from "~/design/State";
import { useFamily, useTopic } from "~/live/hooks";
import type { DefinitionView } from "~/live/messages";
import { useQuery } from "~/route/query";
import { marksOfStatistics } from "../diagram/marks";
import { useMarkWords } from "../diagram/words";
import { bpmnPath, SERVICE, useBpmn, type DefinitionRecord, type Statistics } from "../records";
import { Activities } from "./Activities";
import "./DefinitionPanel.css";

const Diagram = lazy(() => import("../diagram/Diagram"));

export interface DefinitionPanelProps {
  name: string;
  onStart: (definition: DefinitionView, version: number) => void;
}

export function DefinitionPanel({ name, onStart }: DefinitionPanelProps) {
  const { t } = useTranslation("processes");
  const [asked, setAsked] = useQuery("version");
  const latest = useTopic(`definition/${name}`);
  const version = Number.parseInt(asked, 10) || (latest?.version ?? null);
  const path = `definitions/${encodeURIComponent(name)}`;
  const record = useAsked<DefinitionRecord & { unusable?: string } & DefinitionView>(
    SERVICE,
    version === null ? path : `${path}?version=${version}`,
  );
  const definition = record.value;
  if (record.missing) return <Empty title={t("definition.missing", { name })}>{t("definition.missingHow")}</Empty>;
  if (definition === null) {
    return record.failure === null ? (
      <p className="processes__loading quiet">{t("definition.loading")}</p>
    ) : (
      <Problem>{t("unread", { why: record.failure })}</Problem>
    );
  }
  const newest = Math.max(latest?.version ?? 0, definition.version);
  const versions = Array.from({ length: newest }, (_none, nth) => newest - nth);
  return (
    <div className="definition">
      <header className="definition__head">
        <div className="definition__name">
          <h1>{definition.title}</h1>
          <span className="quiet">
            {t("definition.deployed")} <Ago at={definition.deployedAt} isStop />
          </span>
          {definition.label !== null && definition.label !== String(definition.version) && <span className="quiet">{t("definition.label", { label: definition.label })}</span>}
        </div>
        <div className="definition__acts">
          <Pick
            label={t("definition.version")}
            value={String(definition.version)}
            options={versions.map((one) => ({
              value: String(one),
              name: t(one === newest ? "definition.latest" : "version", { version: one }),
            }))}
            onChange={(one) => setAsked(Number(one) === newest ? "" : one)}
          />
          <DownloadButton name={definition.name} version={definition.version} />
          <Button
            kind="main"
            icon={<Play aria-hidden size={18} />}
            isDisabled={definition.unusable !== undefined}
            onPress={() => onStart(definition, definition.version)}
          >
            {t("start.act", { title: definition.title })}
          </Button>
        </div>
        {definition.unusable !== undefined && <Problem>{t("definition.unusable", { why: definition.unusable })}</Problem>}
      </header>
      <Body definition={definition} />
    </div>
  );
}

function Body({ definition }: { definition: DefinitionRecord & DefinitionView }) {
  const { t } = useTranslation("processes");
  const words = useMarkWords("all");
  const bpmn = useBpmn(definition.name, definition.version);
  const turn = useTurns(definition.name);
  const path = `definitions/${encodeURIComponent(definition.name)}/statistics?version=${definition.version}`;
  const statistics = useAsked<Statistics>(SERVICE, path, turn);
  const elements = statistics.value?.elements;
  const marks = useMemo(() => marksOfStatistics(elements ?? {}, words), [elements, words]);
  const [centred, setCentred] = useState<{ element: string; at: number } | null>(null);
  return (
    <>
      <div className="definition__counts">
        {statistics.value !== null && <Counts statistics={statistics.value} />}
        {statistics.failure !== null && <Problem>{t("unread", { why: statistics.failure })}</Problem>}
      </div>
      <div className="definition__diagram">
        {bpmn.failure !== null && <Problem>{t("diagram.unread", { why: bpmn.failure })}</Problem>}
        {bpmn.value !== null && (
          <Suspense fallback={<p className="processes__loading quiet">{t("diagram.loading")}</p>}>
            <Diagram xml={bpmn.value} label={t("diagram.ofDefinition", { title: definition.title })} marks={marks} centred={centred} />
          </Suspense>
        )}
      </div>
      <Activities
        activities={definition.activities}
        counts={elements ?? {}}
        onPick={(element) => setCentred({ element, at: Date.now() })}
      />
    </>
  );
}

function Counts({ statistics }: { statistics: Statistics }) {
  const { t } = useTranslation("processes");
  const { running, completed, failed } = statistics.processes;
  return (
    <p className="definition__states">
      {running + completed + failed === 0 && <span className="quiet">{t("definition.never")}</span>}
      {running > 0 && <State tone="accent">{t("definition.running", { count: running })}</State>}
      {completed > 0 && <State tone="ok">{t("definition.completed", { count: completed })}</State>}
      {failed > 0 && <State tone="stop">{t("definition.failed", { count: failed })}</State>}
    </p>
  );
}

/** Something that is another whenever a process of the definition has got further. */
function useTurns(name: string): string {
  const processes = useFamily("process");
  return processes
    .filter((process) => process.definition === name)
    .map((process) => `${process.id} ${process.status} ${process.tasks.length} ${process.waiting.join(" ")}`)
    .join("\n");
}

function DownloadButton({ name, version }: { name: string; version: number }) {
  const { t } = useTranslation("processes");
  const [failure, setFailure] = useState<string | null>(null);
  return (
    <>
      <Button
        icon={<Download aria-hidden size={18} />}
        onPress={() => {
          setFailure(null);
          callService<string>("task-orchestrator", bpmnPath(name, version)).then(
            (xml) => download(`${name}-${version}.bpmn`, "application/xml", xml),
            (error: unknown) => setFailure(describe(error)),
          );
        }}
      >
        {t("definition.download")}
      </Button>
      {failure !== null && <Problem>{t("unread", { why: failure })}</Problem>}
    </>
  );
}
