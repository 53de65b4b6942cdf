/** A process: where it is, on its diagram, and what became of its Tasks, below. */
import { lazy, Suspense, useMemo } from "react";
import { useTranslation } from "react-i18next";
import { SegmentedControl } from "~/design/SegmentedControl";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import type { ProcessView } from "~/live/messages";
import { useQueryParameter } from "~/route/queryParameter";
import { marksOfProcess, withPicked } from "../diagram/marks";
import { useMarkWords } from "../diagram/words";
import { taskMark } from "../names";
import { useBpmn, useProcess } from "../records";
import { TasksBar } from "../timeline/TasksBar";
import { TasksView } from "../timeline/TasksView";
import { ProcessHead } from "./ProcessHead";
import { TaskPanel } from "./TaskPanel";
import { Values } from "./Values";
import "./ProcessPanel.css";

const Diagram = lazy(() => import("../diagram/Diagram"));

export const VIEWS = ["timeline", "table", "values"] as const;
export type View = (typeof VIEWS)[number];

export function ProcessPanel({ id }: { id: string }) {
  const { t } = useTranslation("processes");
  const { value: process, failure, missing } = useProcess(id);
  if (process !== null) return <Shown process={process} />;
  if (missing) return <EmptyState title={t("process.missing", { id })}>{t("process.missingHow")}</EmptyState>;
  if (failure !== null) return <ErrorMessage>{t("unread", { why: failure })}</ErrorMessage>;
  return <p className="processes__loading quiet">{t("process.loading")}</p>;
}

function Shown({ process }: { process: ProcessView }) {
  const { t } = useTranslation("processes");
  const [asked, setView] = useQueryParameter("view", "timeline");
  const view = VIEWS.find((one) => one === asked) ?? "timeline";
  const [picked, setPicked] = useQueryParameter("task");
  const task = process.tasks.find((one) => taskMark(one) === picked) ?? null;
  return (
    <div className="process">
      <ProcessHead process={process} />
      <ProcessDiagram
        process={process}
        picked={task?.element ?? null}
        onPick={(element) => {
          const last = process.tasks.findLast((one) => one.element === element);
          setPicked(last === undefined ? "" : taskMark(last));
        }}
      />
      <section className="process__tasks" aria-label={t("views.label")}>
        <div className="process__views">
          <SegmentedControl
            label={t("views.label")}
            value={view}
            options={VIEWS.map((value) => ({ value, name: t(`views.${value}`) }))}
            onChange={setView}
          />
          {view !== "values" && <TasksBar process={process} />}
        </div>
        <div className="process__below">
          {view === "values" ? (
            <Values process={process} />
          ) : (
            <TasksView process={process} view={view} picked={picked} onPick={setPicked} />
          )}
          {task !== null && view !== "values" && (
            <TaskPanel process={process} task={task} onClose={() => setPicked("")} />
          )}
        </div>
      </section>
    </div>
  );
}

interface ProcessDiagramProps {
  process: ProcessView;
  picked: string | null;
  onPick: (element: string | null) => void;
}

function ProcessDiagram({ process, picked, onPick }: ProcessDiagramProps) {
  const { t } = useTranslation("processes");
  const words = useMarkWords("process");
  const bpmn = useBpmn(process.definition, process.version);
  const { waiting, elements } = process;
  const marks = useMemo(
    () => withPicked(marksOfProcess({ waiting, elements }, words), picked),
    [waiting, elements, words, picked],
  );
  if (bpmn.failure !== null) return <ErrorMessage>{t("diagram.unread", { why: bpmn.failure })}</ErrorMessage>;
  return (
    <div className="process__diagram">
      {bpmn.value !== null && (
        <Suspense fallback={<p className="processes__loading quiet">{t("diagram.loading")}</p>}>
          <Diagram xml={bpmn.value} label={t("diagram.ofProcess", { title: process.title })} marks={marks} onPick={onPick} />
        </Suspense>
      )}
    </div>
  );
}
