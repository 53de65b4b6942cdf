/** What a page asks a service for: loaded when it opens, and again when told. */
import { useCallback, useEffect, useState } from "react";
import { callService, describe, type Service } from "./http";

export interface Loaded<T> {
  value: T | null;
  failure: string | null;
  reload: () => void;
}

/** Load `path` of `service`; null: nothing for now. A value stays until the next one is there. */
export function useLoaded<T>(service: Service, path: string | null): Loaded<T> {
  const [turn, setTurn] = useState(0);
  const [loaded, setLoaded] = useState<{ path: string; value: T | null; failure: string | null } | null>(null);
  useEffect(() => {
    if (path === null) return;
    const away = new AbortController();
    callService<T>(service, path, { signal: away.signal }).then(
      (value) => setLoaded({ path, value, failure: null }),
      (error: unknown) => {
        if (!away.signal.aborted) setLoaded((before) => ({ path, value: before?.path === path ? before.value : null, failure: describe(error) }));
      },
    );
    return () => away.abort();
  }, [service, path, turn]);
  const reload = useCallback(() => setTurn((before) => before + 1), []);
  const mine = loaded !== null && loaded.path === path ? loaded : null;
  return { value: mine?.value ?? null, failure: mine?.failure ?? null, reload };
}
