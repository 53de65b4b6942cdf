/** Families of topics read at most once a second: for lists, which need not follow each frame of a glove. */
import { useCallback, useSyncExternalStore } from "react";
import { useLive, useProcessTexts, type Families } from "./hooks";

const SAMPLE_MS = 1000;

/** All values of a family, in the order of their names; a change shows at once if the last one was a second ago. */
export function useSampledFamily<F extends keyof Families>(family: F): readonly Families[F][] {
  const live = useLive();
  const texts = useProcessTexts();
  const watch = useCallback(
    (listener: () => void) => {
      let timer: ReturnType<typeof setTimeout> | undefined;
      let lastMs = 0;
      const notify = () => {
        timer = undefined;
        lastMs = performance.now();
        listener();
      };
      const stop = live.watchFamily(family, () => {
        timer ??= setTimeout(notify, Math.max(0, lastMs + SAMPLE_MS - performance.now()));
      });
      return () => {
        clearTimeout(timer);
        stop();
      };
    },
    [live, family],
  );
  const values = useSyncExternalStore(watch, () => live.list(family) as readonly Families[F][]);
  return family === "glove" ? texts.localized(values) : values;
}
