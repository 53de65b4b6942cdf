/** The statistics of a definition, or of all: totals, heat map, throughput, elements, resources, incidents, processes. */
import { useTranslation } from "react-i18next";
import type { DefinitionTimes } from "~/api/generated/task-orchestrator";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { duration } from "~/design/times";
import { number } from "~/design/numbers";
import { useNow } from "~/live/clock";
import { useQueryParameter } from "~/route/queryParameter";
import { Export } from "../Export";
import { statisticsQuery, type Scope } from "../query";
import { ProcessTable } from "../processes/ProcessTable";
import { CauseTable } from "./CauseTable";
import { DefinitionTable } from "./DefinitionTable";
import { ElementTable } from "./ElementTable";
import { hasEnough } from "./figures";
import { HeatMap } from "./HeatMap";
import { ResourceTable } from "./ResourceTable";
import { ThroughputChart } from "./ThroughputChart";
import { useCauses, useDefinitions, useElements, useResources, useThroughput } from "./useStatistics";

export interface StatisticsViewProps {
  scope: Scope;
  onDefinition: (name: string) => void;
}

export function StatisticsView({ scope, onDefinition }: StatisticsViewProps) {
  const { t } = useTranslation("cockpit");
  const now = useNow();
  const [element, setElement] = useQueryParameter("element");
  const elements = useElements(scope);
  const definitions = useDefinitions(scope);
  const throughput = useThroughput(scope, Math.floor(now / 3_600_000) * 3_600_000);
  const resources = useResources(scope);
  const causes = useCauses(scope);
  const failure = [elements, definitions, throughput, resources, causes].find((one) => one.failure !== null)?.failure ?? null;
  const isOne = scope.definition !== "";
  const total = isOne ? elements.value?.processes : sumOf(definitions.value ?? []);
  const query = statisticsQuery(scope);
  return (
    <div className="cockpit__grid">
      {failure !== null && <ErrorMessage>{t("unread", { why: failure })}</ErrorMessage>}
      {total !== undefined && <Totals total={total} />}
      {isOne && (
        <HeatMap scope={scope} elements={elements.value?.elements ?? []} causes={causes.value ?? []} title={elements.value?.processes.title ?? scope.definition} picked={element} onPick={setElement} />
      )}
      <div className="cockpit__columns">
        {!isOne && (
          <Card className="cockpit__wide" title={t("definitions.title")} aside={<Export path={`statistics/definitions?${query}`} name="definitions" />}>
            <DefinitionTable rows={definitions.value ?? []} onOpen={onDefinition} />
          </Card>
        )}
        {isOne && (
          <Card className="cockpit__wide" title={t("elements.title")} aside={<Export path={`statistics/elements?${query}`} name="elements" />}>
            <ElementTable rows={elements.value?.elements ?? []} picked={element} onPick={setElement} />
          </Card>
        )}
        <Card title={t("throughput.title")} aside={<Export path={`statistics/throughput?${query}`} name="throughput" />}>
          {throughput.value !== null && <ThroughputChart points={throughput.value.points} period={scope.period} />}
        </Card>
        <Card title={t("causes.title")} aside={<Export path={`statistics/incidents?${incidentQuery(scope)}`} name="incidents" />}>
          <CauseTable rows={causes.value ?? []} isLoaded={causes.value !== null} onPick={setElement} />
        </Card>
        <Card title={t("resources.title")} aside={<Export path={`statistics/resources?${query}`} name="resources" />}>
          <ResourceTable rows={resources.value?.resources ?? []} isLoaded={resources.value !== null} />
        </Card>
      </div>
      <ProcessTable scope={scope} element={element} onElement={setElement} resources={(resources.value?.resources ?? []).map((one) => one.resource)} />
    </div>
  );
}

function incidentQuery({ definition, version }: Scope): string {
  return new URLSearchParams(Object.entries({ definition, version }).filter(([, value]) => value !== "")).toString();
}

type Total = Pick<DefinitionTimes, "running" | "withIncidents" | "started" | "completed" | "failed"> & Partial<Pick<DefinitionTimes, "medianMs" | "p90Ms" | "meanMs">>;

export function sumOf(definitions: readonly DefinitionTimes[]): Total {
  const sum = { running: 0, withIncidents: 0, started: 0, completed: 0, failed: 0 };
  for (const one of definitions) for (const name of Object.keys(sum) as (keyof typeof sum)[]) sum[name] += one[name];
  return sum;
}

function Totals({ total }: { total: Total }) {
  const { t, i18n } = useTranslation("cockpit");
  const counts = (["running", "withIncidents", "started", "completed", "failed"] as const).map((name) => [name, number(total[name], i18n.language)] as const);
  const times = (["medianMs", "p90Ms", "meanMs"] as const)
    .filter((name) => total[name] !== undefined && total[name] !== null && hasEnough(name, total.completed))
    .map((name) => [name, duration(total[name] ?? 0, i18n.language)] as const);
  return (
    <dl className="cockpit__totals" aria-label={t("totals.label")}>
      {[...counts, ...times].map(([name, value]) => (
        <div key={name} data-stop={(name === "withIncidents" || name === "failed") && total[name] > 0 ? true : undefined}>
          <dt>{t(`totals.${name}`)}</dt>
          <dd>{value}</dd>
        </div>
      ))}
    </dl>
  );
}
