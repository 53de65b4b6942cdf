/** The statistics of the scope that is shown, asked for again and again while the page is open. */
import type { CauseView, DefinitionTimes, ElementsView, ResourcesView, ThroughputView } from "~/api/generated/task-orchestrator";
import { useServiceQuery, type ServiceQuery } from "~/api/useServiceQuery";
import { statisticsQuery, stepsOf, type Scope } from "../query";

export const REFRESH_MS = 10_000;
const SERVICE = "task-orchestrator";

function useStatistics<T>(path: string | null): ServiceQuery<T> {
  return useServiceQuery<T>(SERVICE, path === null ? null : `statistics/${path}`, { intervalMs: REFRESH_MS });
}

export function useElements(scope: Scope): ServiceQuery<ElementsView> {
  return useStatistics(scope.definition === "" ? null : `elements?${statisticsQuery(scope)}`);
}

export function useDefinitions({ period }: Scope): ServiceQuery<DefinitionTimes[]> {
  return useStatistics(`definitions?${statisticsQuery({ definition: "", version: "", period })}`);
}

export function useThroughput(scope: Scope, nowMs: number): ServiceQuery<ThroughputView> {
  return useStatistics(`throughput?${statisticsQuery(scope, { step: stepsOf(scope.period, nowMs).asked })}`);
}

export function useResources(scope: Scope): ServiceQuery<ResourcesView> {
  return useStatistics(`resources?${statisticsQuery(scope)}`);
}

export function useCauses({ definition, version }: Scope): ServiceQuery<CauseView[]> {
  const query = new URLSearchParams();
  if (definition !== "") query.set("definition", definition);
  if (version !== "") query.set("version", version);
  return useStatistics(`incidents?${query.toString()}`);
}
