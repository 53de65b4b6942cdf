/** The rules of the ROS bridge, polled while they are shown. */
import { useMutation } from "@tanstack/react-query";
import { useCallback } from "react";
import { errorText, requestService } from "~/api/http";
import { queryClient, useServiceQuery } from "~/api/useServiceQuery";

const POLL_INTERVAL_MS = 2000;

/** A rule as the bridge shows it; rates are per second. */
export interface RuleView {
  name: string;
  section: string;
  enabled: boolean;
  from: string;
  to: string;
  type: string | null;
  received: number;
  receivedPerS: number;
  forwarded: number;
  forwardedPerS: number;
  dropped: number;
  lastValue: unknown;
  lastError: string | null;
  lastErrorAt: string | null;
  /** Of a rule that subscribes to a topic: its number of publishers, and the last message that could not be decoded. */
  publishers?: number;
  lastUnreadable?: string | null;
}

export interface Rules {
  /** None until the bridge has answered. */
  rules: readonly RuleView[] | null;
  failure: string | null;
  /** Switch a rule on or off, for good. */
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

/** A value in a line, whatever it is; a long one ends in "…". */
export function oneLine(value: unknown, maxLength = 160): string {
  if (value === null || value === undefined) return "";
  const line = typeof value === "string" ? value : JSON.stringify(value);
  return line.length <= maxLength ? line : `${line.slice(0, maxLength - 1)}…`;
}

export type Standing = "off" | "silent" | "works" | "waits";

/** How a rule stands: switched off, nobody to listen to, at work, or at work with nothing to do yet. */
export function standing(rule: RuleView): Standing {
  if (!rule.enabled) return "off";
  if (rule.publishers === 0) return "silent";
  return rule.received > 0 ? "works" : "waits";
}
