/** The gloves as Home needs them: a moving hand does not render it. */
import { useMemo, useSyncExternalStore } from "react";
import { useLive, useProcessTexts } from "~/live/hooks";
import type { GloveTask, GloveView } from "~/live/messages";
import type { LiveStore } from "~/live/store";

export interface HomeGlove {
  glove: string;
  connected: boolean;
  person: string | null;
  task: Pick<GloveTask, "id" | "description"> | null;
}

export function useHomeGloves(): readonly HomeGlove[] {
  const live = useLive();
  const texts = useProcessTexts();
  const sent = useSyncExternalStore((listener) => live.watchFamily("glove", listener), () => summary(live));
  return useMemo(() => texts.localized(JSON.parse(sent) as HomeGlove[]), [sent, texts]);
}

/** As text, so that what has not changed is an equal value. */
function summary(live: LiveStore): string {
  return JSON.stringify(
    (live.list("glove") as readonly GloveView[]).map(({ glove, connected, person, task }): HomeGlove => ({
      glove,
      connected,
      person,
      task: task === null ? null : { id: task.id, description: task.description },
    })),
  );
}
