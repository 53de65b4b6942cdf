/** Requests of one panel that change something, with the text of the last failure. */
import { useState } from "react";
import { errorText, requestService, type RequestOptions } from "~/api/http";
import { SERVICE } from "./humanoid";

export interface Acts {
  failure: string | null;
  isBusy: boolean;
  act: (path: string, json?: unknown, method?: RequestOptions["method"]) => Promise<boolean>;
}

/** `onDone` is called after each act that has succeeded. */
export function useAct(onDone?: () => void): Acts {
  const [failure, setFailure] = useState<string | null>(null);
  const [isBusy, setBusy] = useState(false);
  const act: Acts["act"] = async (path, json, method = "POST") => {
    setFailure(null);
    setBusy(true);
    try {
      await requestService(SERVICE, path, { method, ...(json === undefined ? {} : { json }) });
      onDone?.();
      return true;
    } catch (error) {
      setFailure(errorText(error));
      return false;
    } finally {
      setBusy(false);
    }
  };
  return { failure, isBusy, act };
}
