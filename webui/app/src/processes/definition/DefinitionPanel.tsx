/** A definition: its diagram with what became of all its processes, its versions, and a way to start one. */
import { Download, GitBranch, Play } from "lucide-react";
import { lazy, Suspense, useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { download } from "~/api/download";
import type { DefinitionView, DefinitionWithActivities, VersionStatistics } from "~/api/generated/task-orchestrator";
import { requestService, errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { RelativeTime } from "~/design/RelativeTime";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { Select } from "~/design/Select";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { useFamily, useTopic } from "~/live/hooks";
import { UnknownAddress } from "~/route/choice";
import { UnknownName } from "~/route/UnknownName";
import { useQueryParameter } from "~/route/queryParameter";
import { MayNot } from "~/design/MayNot";
import { marksOfStatistics } from "../diagram/marks";
import { useMarkWords } from "../diagram/words";
import { shortTitle } from "../names";
import { MigrateAllDialog } from "../migration/MigrateAllDialog";
import { Holds } from "../pause/Holds";
import { PaceButton } from "../pause/PaceButton";
import { bpmnPath, SERVICE, useBpmn } from "../records";
import { Activities } from "./Activities";
import "./DefinitionPanel.css";

const Diagram = lazy(() => import("../diagram/Diagram"));

export interface DefinitionPanelProps {
  name: string;
  onStart: (definition: DefinitionView, version: number) => void;
  onDeleted: () => void;
}

export function DefinitionPanel({ name, onStart, onDeleted }: DefinitionPanelProps) {
  const { t } = useTranslation("processes");
  const [asked, setAsked] = useQueryParameter("version");
  const latest = useTopic(`definition/${name}`);
  if (asked !== "" && !/^[1-9]\d*$/.test(asked)) throw new UnknownAddress("version", asked);
  const version = asked === "" ? (latest?.version ?? null) : Number(asked);
  const path = `definitions/${encodeURIComponent(name)}`;
  const record = useServiceQuery<DefinitionWithActivities>(
    SERVICE,
    version === null ? path : `${path}?version=${version}`,
  );
  const definition = record.value;
  if (record.missing && latest !== undefined) return <UnknownName thing="value" name={t("version", { version: asked })} parameter="version" />;
  if (record.missing) return <EmptyState title={t("definition.missing", { name })}>{t("definition.missingHow")}</EmptyState>;
  if (definition === null) {
    return record.failure === null ? (
      <p className="processes__loading quiet">{t("definition.loading")}</p>
    ) : (
      <ErrorMessage>{t("unread", { why: record.failure })}</ErrorMessage>
    );
  }
  const newest = Math.max(latest?.version ?? 0, definition.version);
  const isDeleted = definition.deletedVersions.includes(definition.version);
  const versions = Array.from({ length: newest }, (_none, nth) => newest - nth).filter((one) => one === definition.version || !definition.deletedVersions.includes(one));
  return (
    <div className="definition">
      <header className="definition__head">
        <div className="definition__name">
          <h1>{definition.title}</h1>
          <span className="quiet">
            {t("definition.deployed")} <RelativeTime at={definition.deployedAt} isStop />
          </span>
          {definition.label !== null && definition.label !== String(definition.version) && <span className="quiet">{t("definition.label", { label: definition.label })}</span>}
        </div>
        <div className="definition__actions">
          <Select
            label={t("definition.version")}
            value={String(definition.version)}
            options={versions.map((one) => ({
              value: String(one),
              name: t(one === newest ? "definition.latest" : "version", { version: one }),
            }))}
            onChange={(one) => setAsked(Number(one) === newest ? "" : one)}
          />
          <DownloadButton name={definition.name} version={definition.version} />
          <Button permission="runProcesses"
            kind="main"
            icon={<Play aria-hidden size={18} />}
            isDisabled={isDeleted || definition.unusable !== undefined || definition.holds.some(({ kind }) => kind === "suspended")}
            onPress={() => onStart(definition, definition.version)}
          >
            {t("start.act", { title: shortTitle(definition.title) })}
          </Button>
        </div>
        <MayNot permission="runProcesses" />
        <Holds definition={definition} newest={newest} onChanged={record.reload} onDeleted={onDeleted} />
        {definition.unusable !== undefined && <ErrorMessage>{t("definition.unusable", { why: definition.unusable })}</ErrorMessage>}
      </header>
      <Body definition={definition} newest={newest} />
    </div>
  );
}

function Body({ definition, newest }: { definition: DefinitionWithActivities; newest: number }) {
  const { t } = useTranslation("processes");
  const words = useMarkWords("all");
  const bpmn = useBpmn(definition.name, definition.version);
  const turn = useTurns(definition.name);
  const path = `definitions/${encodeURIComponent(definition.name)}/statistics?version=${definition.version}`;
  const statistics = useServiceQuery<VersionStatistics>(SERVICE, path, { revision: turn });
  const elements = statistics.value?.elements;
  const marks = useMemo(() => marksOfStatistics(elements ?? {}, words), [elements, words]);
  const running = statistics.value?.processes.running ?? 0;
  const [centred, setCentred] = useState<{ element: string; at: number } | null>(null);
  return (
    <>
      <div className="definition__counts">
        {statistics.value !== null && <Counts statistics={statistics.value} />}
        {running > 0 && <Running definition={definition} newest={newest} />}
        {statistics.failure !== null && <ErrorMessage>{t("unread", { why: statistics.failure })}</ErrorMessage>}
      </div>
      <div className="definition__diagram">
        {bpmn.failure !== null && <ErrorMessage>{t("diagram.unread", { why: bpmn.failure })}</ErrorMessage>}
        {bpmn.value !== null && (
          <Suspense fallback={<p className="processes__loading quiet">{t("diagram.loading")}</p>}>
            <Diagram xml={bpmn.value} label={t("diagram.ofDefinition", { title: definition.title })} marks={marks} centred={centred} />
          </Suspense>
        )}
      </div>
      <Activities
        activities={definition.activities}
        counts={elements ?? {}}
        allocation={definition.allocation}
        onPick={(element) => setCentred({ element, at: Date.now() })}
      />
    </>
  );
}

/** What can be done with the running processes of a version. */
function Running({ definition, newest }: { definition: DefinitionWithActivities; newest: number }) {
  const { t } = useTranslation("processes");
  const [migrates, setMigrates] = useState(false);
  const { name, title, version } = definition;
  const paused = useFamily("process").filter((process) => process.definition === name && process.status === "paused");
  return (
    <div className="definition__running">
      <PaceButton pace="pause" of={{ definition: name, title }} />
      {paused.length > 0 && <PaceButton pace="resume" of={{ definition: name, title }} />}
      {version !== newest && (
        <Button icon={<GitBranch aria-hidden size={18} />} onPress={() => setMigrates(true)}>
          {t("migration.openAll", { version: newest })}
        </Button>
      )}
      {migrates && <MigrateAllDialog definition={name} title={title} source={version} target={newest} onClose={() => setMigrates(false)} />}
    </div>
  );
}

function Counts({ statistics }: { statistics: VersionStatistics }) {
  const { t } = useTranslation("processes");
  const { running, completed, failed } = statistics.processes;
  return (
    <p className="definition__states">
      {running + completed + failed === 0 && <span className="quiet">{t("definition.never")}</span>}
      {running > 0 && <StatusBadge tone="accent">{t("definition.running", { count: running })}</StatusBadge>}
      {completed > 0 && <StatusBadge tone="ok">{t("definition.completed", { count: completed })}</StatusBadge>}
      {failed > 0 && <StatusBadge tone="stop">{t("definition.failed", { count: failed })}</StatusBadge>}
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
          requestService<string>("task-orchestrator", bpmnPath(name, version)).then(
            (xml) => download(`${name}-${version}.bpmn`, "application/xml", xml),
            (error: unknown) => setFailure(errorText(error)),
          );
        }}
      >
        {t("definition.download")}
      </Button>
      {failure !== null && <ErrorMessage>{t("unread", { why: failure })}</ErrorMessage>}
    </>
  );
}
