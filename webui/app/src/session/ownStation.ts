/** The station as which this screen is signed in, with its gloves and the person who has joined. */
import type { StationView } from "~/api/generated/accounts";
import { useServiceQuery } from "~/api/useServiceQuery";
import { useSession } from "./session";

const REFRESH_MS = 5_000;

export interface OwnStation {
  isStation: boolean;
  /** Null while it loads, and for a screen that is no station. */
  station: StationView | null;
  reload: () => void;
}

export function useOwnStation(): OwnStation {
  const isStation = useSession().user?.isStation === true;
  const { value, reload } = useServiceQuery<StationView>("accounts", isStation ? "me/station" : null, { intervalMs: REFRESH_MS });
  return { isStation, station: value, reload };
}
