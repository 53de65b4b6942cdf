/** The rules of the ROS bridge, polled while the page shows them. */
import { useMutation } from "@tanstack/react-query";
import { useCallback } from "react";
import type { RuleView } from "~/api/generated/ros-bridge";
import { errorText, requestService } from "~/api/http";
import { queryClient, useServiceQuery } from "~/api/useServiceQuery";

const POLL_INTERVAL_MS = 2000;

export type { RuleView };

export interface Rules {
  /** Null until the bridge has responded. */
  rules: readonly RuleView[] | null;
  failure: string | null;
  /** Switch a rule on or off, also after a restart. */
  turn: (rule: RuleView, on: boolean) => void;
}

export function useRules(): Rules {
  const { value, failure, reload } = useServiceQuery<RuleView[]>("ros-bridge", "rules", { intervalMs: POLL_INTERVAL_MS });
  const { mutate, error } = useMutation(
    {
      mutationFn: ({ rule, on }: { rule: RuleView; on: boolean }) =>
        requestService("ros-bridge", `rules/${encodeURIComponent(rule.name)}/${on ? "enable" : "disable"}`, { method: "POST" }),
      onSuccess: reload,
    },
    queryClient,
  );
  const turn = useCallback((rule: RuleView, on: boolean) => mutate({ rule, on }), [mutate]);
  return { rules: value, failure: error === null ? failure : errorText(error), turn };
}

/** A value as one line; a long one is cut with "…". */
export function oneLine(value: unknown, maxLength = 160): string {
  if (value === null || value === undefined) return "";
  const line = typeof value === "string" ? value : JSON.stringify(value);
  return line.length <= maxLength ? line : `${line.slice(0, maxLength - 1)}…`;
}

export type Standing = "off" | "silent" | "works" | "waits";

/** The state of a rule: off, without a publisher, receiving, or waiting for the first message. */
export function stateOf(rule: RuleView): Standing {
  if (!rule.enabled) return "off";
  if (rule.publishers === 0) return "silent";
  return rule.received > 0 ? "works" : "waits";
}
