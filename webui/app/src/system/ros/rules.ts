/** The rules of the ROS bridge, asked again and again while somebody looks at them. */
import { useCallback, useEffect, useState } from "react";
import { callService, describe } from "~/api/http";

const ASK_EVERY_MS = 2000;

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
  /** Of a rule that listens to a topic: how many speak on it, and what could not be read. */
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
  const [rules, setRules] = useState<readonly RuleView[] | null>(null);
  const [failure, setFailure] = useState<string | null>(null);
  const [turned, setTurned] = useState(0);

  useEffect(() => {
    const leaving = new AbortController();
    const ask = () => {
      callService<RuleView[]>("ros-bridge", "rules", { signal: leaving.signal }).then(
        (received) => {
          setRules(received);
          setFailure(null);
        },
        (error: unknown) => {
          if (!leaving.signal.aborted) setFailure(describe(error));
        },
      );
    };
    ask();
    const asking = setInterval(ask, ASK_EVERY_MS);
    return () => {
      clearInterval(asking);
      leaving.abort();
    };
  }, [turned]);

  const turn = useCallback((rule: RuleView, on: boolean) => {
    const path = `rules/${encodeURIComponent(rule.name)}/${on ? "enable" : "disable"}`;
    callService("ros-bridge", path, { method: "POST" }).then(
      () => setTurned((count) => count + 1),
      (error: unknown) => setFailure(describe(error)),
    );
  }, []);

  return { rules, failure, turn };
}

/** A value in a line, whatever it is; a long one ends in "…". */
export function inALine(value: unknown, longest = 160): string {
  if (value === null || value === undefined) return "";
  const line = typeof value === "string" ? value : JSON.stringify(value);
  return line.length <= longest ? line : `${line.slice(0, longest - 1)}…`;
}

export type Standing = "off" | "silent" | "works" | "waits";

/** How a rule stands: switched off, nobody to listen to, at work, or at work with nothing to do yet. */
export function standing(rule: RuleView): Standing {
  if (!rule.enabled) return "off";
  if (rule.publishers === 0) return "silent";
  return rule.received > 0 ? "works" : "waits";
}
