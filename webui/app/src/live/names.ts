/** The names of a family of topics; they change only when a topic is added or removed. */
import { useMemo, useSyncExternalStore } from "react";
import { useLive } from "./hooks";
import type { LiveStore } from "./store";

/** The names of all gloves; a moving hand does not render the list. */
export function useGloveNames(): string[] {
  return useNames("glove", (value) => (value as { glove: string }).glove);
}

export function useRobotNames(): string[] {
  return useNames("robot", (value) => (value as { id: string }).id);
}

function useNames(family: string, nameOf: (value: unknown) => string): string[] {
  const live = useLive();
  const names = useSyncExternalStore(
    (listener) => live.watchFamily(family, listener),
    () => joined(live, family, nameOf),
  );
  return useMemo(() => (names === "" ? [] : names.split("\n")), [names]);
}

function joined(live: LiveStore, family: string, nameOf: (value: unknown) => string): string {
  return live.list(family).map(nameOf).join("\n");
}
