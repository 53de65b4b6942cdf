/** A setting of the user that is kept on the server. */
import { useCallback, useEffect, useRef, useState } from "react";
import { request } from "~/api/http";

const SAVE_AFTER_MS = 500;

/**
 * Return the setting and how to change it; `standard` until it is loaded, and when `isValid` does not accept what is
 * stored. A setting that cannot be stored stays in this page.
 */
export function useUserSetting<T extends object>(name: string, standard: T, isValid: (value: unknown) => value is T): [T, (value: T) => void] {
  const [value, setValue] = useState(standard);
  const saving = useRef<ReturnType<typeof setTimeout> | undefined>(undefined);
  const valid = useRef(isValid);
  useEffect(() => {
    const loading = new AbortController();
    request<unknown>(`user-settings/${name}`, { signal: loading.signal })
      .then((stored) => {
        if (!loading.signal.aborted && valid.current(stored)) setValue(stored);
      })
      .catch(() => {
        // The standard stays.
      });
    return () => loading.abort();
  }, [name]);
  const change = useCallback(
    (next: T) => {
      setValue(next);
      clearTimeout(saving.current);
      saving.current = setTimeout(() => {
        request(`user-settings/${name}`, { method: "PUT", json: next }).catch(() => {
          // The page says that the server is away.
        });
      }, SAVE_AFTER_MS);
    },
    [name],
  );
  return [value, change];
}
