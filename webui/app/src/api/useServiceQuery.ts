/** Loads resources of the services with TanStack Query: equal requests are shared, transient errors retried. */
import { keepPreviousData, QueryClient, useQuery } from "@tanstack/react-query";
import { useCallback, useEffect, useRef } from "react";
import { useProcessTexts } from "~/live/hooks";
import { ApiError, errorText, requestService, type Service } from "./http";

const RETRY_MS = 3000;

/** Requests also run while the browser is offline: the server may be on this machine. */
export const queryClient = new QueryClient({
  defaultOptions: {
    queries: { networkMode: "always", refetchOnWindowFocus: false, gcTime: 0, retry: (_count, error) => isTransient(error), retryDelay: RETRY_MS },
    mutations: { networkMode: "always" },
  },
});

export interface ServiceQuery<T> {
  /** The last value; it stays while the service cannot be reached. */
  value: T | null;
  /** Why the last request failed, for people. */
  failure: string | null;
  /** The service has no such resource. */
  missing: boolean;
  reload: () => void;
}

export interface ServiceQueryOptions {
  /** Another value causes another request. */
  revision?: string | number;
  intervalMs?: number;
  /** While another path loads, the value of the path before it stays. */
  keepsPrevious?: boolean;
}

/** Load `path` of `service`; null loads nothing. Texts of processes are in the language of the page. */
export function useServiceQuery<T>(service: Service, path: string | null, { revision = "", intervalMs, keepsPrevious = false }: ServiceQueryOptions = {}): ServiceQuery<T> {
  const { data, error, failureReason, refetch } = useQuery(
    {
      queryKey: [service, path],
      queryFn: ({ signal }) => requestService<T>(service, path ?? "", { signal }),
      enabled: path !== null,
      refetchInterval: (query) => (isServiceMissing(query.state.error) ? false : (intervalMs ?? false)),
      ...(keepsPrevious ? { placeholderData: keepPreviousData<T | undefined> as never } : {}),
    },
    queryClient,
  );
  const texts = useProcessTexts();
  const reload = useCallback(() => void refetch(), [refetch]);
  const loadedRevision = useRef(revision);
  useEffect(() => {
    if (loadedRevision.current === revision) return;
    loadedRevision.current = revision;
    if (path !== null) reload();
  }, [revision, path, reload]);
  const fault = error ?? failureReason;
  return { value: (service === "task-orchestrator" ? texts.localized(data) : data) ?? null, failure: fault === null ? null : errorText(fault), missing: isMissing(fault), reload };
}

function isMissing(error: Error | null): boolean {
  return error instanceof ApiError && error.problem.status === 404;
}

/** The cell has no such service, and will have none before its server is restarted. */
function isServiceMissing(error: Error | null): boolean {
  return error instanceof ApiError && error.problem["detailCode"] === "page.no_such_service";
}

function isTransient(error: Error): boolean {
  return !(error instanceof ApiError) || error.problem.status >= 500;
}
