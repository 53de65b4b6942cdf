/** The comments on a process and on its Tasks. */
import type { TaskComment } from "~/api/generated/task-orchestrator";
import { useServiceQuery } from "~/api/useServiceQuery";
import { ErrorMessage } from "~/design/ErrorMessage";
import { useTopicSelector } from "~/live/hooks";
import { commentOnProcess } from "~/tasks/actions";
import { Comments } from "~/tasks/Comments";
import { SERVICE } from "../records";

/** Comments that were sent without a page are not pushed. */
const REFRESH_MS = 60_000;

export function ProcessComments({ id }: { id: string }) {
  // The ids of its Tasks begin with that of the process.
  const revision = useTopicSelector("comments", (all) =>
    JSON.stringify(Object.entries(all?.counts ?? {}).filter(([subject]) => subject === id || subject.startsWith(`${id}-`))),
  );
  const { value, failure, reload } = useServiceQuery<TaskComment[]>(SERVICE, `processes/${encodeURIComponent(id)}/comments`, { revision, intervalMs: REFRESH_MS });
  return (
    <>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <Comments subject={id} comments={value ?? []} onComment={(request) => commentOnProcess(id, request).then(reload)} />
    </>
  );
}
