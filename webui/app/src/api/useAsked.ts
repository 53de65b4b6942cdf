/** What a service answers when it is asked, for pages that show more than what is live. */
import { useEffect, useState } from "react";
import { callService, describe, Refusal, type Service } from "./http";

export interface Asked<T> {
  value: T | null;
  /** Why there is none, for people. */
  failure: string | null;
  missing: boolean;
}

const NOTHING = { value: null, failure: null, missing: false };

/** What a service answers for `path`; asked again when `path` or `turn` changes, not at all for null. */
export function useAsked<T>(service: Service, path: string | null, turn: string | number = 0): Asked<T> {
  const [answer, setAnswer] = useState<Asked<T> & { path: string | null }>({ ...NOTHING, path: null });
  useEffect(() => {
    if (path === null) return;
    const ending = new AbortController();
    callService<T>(service, path, { signal: ending.signal }).then(
      (value) => setAnswer({ path, value, failure: null, missing: false }),
      (error: unknown) => {
        if (ending.signal.aborted) return;
        const missing = error instanceof Refusal && error.problem.status === 404;
        // What was told before stays in sight while the service is away.
        setAnswer((before) => ({
          path,
          value: before.path === path ? before.value : null,
          failure: describe(error),
          missing,
        }));
      },
    );
    return () => ending.abort();
  }, [service, path, turn]);
  return answer.path === path ? answer : NOTHING;
}
