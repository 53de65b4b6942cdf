/** Runs one action at a time; an error is shown until the next action. */
import { useCallback, useRef, useState } from "react";
import { errorText } from "~/api/http";

export interface ActionState {
  busy: boolean;
  failure: string | null;
  perform: (act: () => Promise<unknown>) => void;
  forget: () => void;
}

export function useAction(): ActionState {
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const isBusy = useRef(false);
  const perform = useCallback((act: () => Promise<unknown>) => {
    if (isBusy.current) return;
    isBusy.current = true;
    setBusy(true);
    setFailure(null);
    void act()
      .catch((error: unknown) => setFailure(errorText(error)))
      .finally(() => {
        isBusy.current = false;
        setBusy(false);
      });
  }, []);
  const forget = useCallback(() => setFailure(null), []);
  return { busy, failure, perform, forget };
}
