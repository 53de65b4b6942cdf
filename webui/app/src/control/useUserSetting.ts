/** A setting of the user that is kept on the server. */
import { useCallback, useEffect, useRef, useState } from "react";
import { request } from "~/api/http";

const SAVE_AFTER_MS = 500;
const SAVE_AGAIN_MS = 3000;

/**
 * Return the setting, how to change it, and whether it is loaded. Before, a change would replace what is stored, so it has no effect.
 *
 * The setting is `standard` until it is loaded, when it cannot be loaded, and when `isValid` does not accept what is stored. A
 * change that cannot be stored is sent again, as long as this page is open.
 */
export function useUserSetting<T extends object>(name: string, standard: T, isValid: (value: unknown) => value is T): [T, (value: T) => void, boolean] {
  const [value, setValue] = useState(standard);
  const [isLoaded, setLoaded] = useState(false);
  const loaded = useRef("");
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
      })
      .finally(() => {
        if (loading.signal.aborted) return;
        loaded.current = name;
        setLoaded(true);
      });
    return () => loading.abort();
  }, [name]);
  const change = useCallback(
    (next: T) => {
      if (loaded.current !== name) return;
      setValue(next);
      const save = () => {
        const mine = saving.current;
        request(`user-settings/${name}`, { method: "PUT", json: next }).catch(() => {
          // The page says that the server is away. A later change replaces this one.
          if (saving.current === mine) saving.current = setTimeout(save, SAVE_AGAIN_MS);
        });
      };
      clearTimeout(saving.current);
      saving.current = setTimeout(save, SAVE_AFTER_MS);
    },
    [name],
  );
  return [value, change, isLoaded];
}
