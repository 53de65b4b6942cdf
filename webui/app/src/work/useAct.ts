/** One act at a time; what goes wrong is told, and stays until the next act. */
import { useCallback, useRef, useState } from "react";
import { describe } from "~/api/http";

export interface Acting {
  busy: boolean;
  failure: string | null;
  perform: (act: () => Promise<unknown>) => void;
  forget: () => void;
}

export function useAct(): Acting {
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const isBusy = useRef(false);
  const perform = useCallback((act: () => Promise<unknown>) => {
    if (isBusy.current) return;
    isBusy.current = true;
    setBusy(true);
    setFailure(null);
    void act()
      .catch((error: unknown) => setFailure(describe(error)))
      .finally(() => {
        isBusy.current = false;
        setBusy(false);
      });
  }, []);
  const forget = useCallback(() => setFailure(null), []);
  return { busy, failure, perform, forget };
}
