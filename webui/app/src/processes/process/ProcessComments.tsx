/** The comments on a process and on its Tasks. */
import type { TaskComment } from "~/api/generated/task-orchestrator";
import { useServiceQuery } from "~/api/useServiceQuery";
import { ErrorMessage } from "~/design/ErrorMessage";
import { commentOnProcess } from "~/tasks/actions";
import { Comments } from "~/tasks/Comments";
import { SERVICE } from "../records";

const REFRESH_MS = 10_000;

export function ProcessComments({ id }: { id: string }) {
  const { value, failure, reload } = useServiceQuery<TaskComment[]>(SERVICE, `processes/${encodeURIComponent(id)}/comments`, { intervalMs: REFRESH_MS });
  return (
    <>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <Comments subject={id} comments={value ?? []} onComment={(request) => commentOnProcess(id, request).then(reload)} />
    </>
  );
}
