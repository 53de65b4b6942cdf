/** A process: where it is, on its diagram, and what became of its Tasks, below. */
import { lazy, Suspense, useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import type { ServiceQuery } from "~/api/useServiceQuery";
import { SegmentedControl } from "~/design/SegmentedControl";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import type { IncidentView, ProcessView } from "~/api/generated/task-orchestrator";
import { useChoice } from "~/route/choice";
import { UnknownName } from "~/route/UnknownName";
import { useQueryChange, useQueryParameter } from "~/route/queryParameter";
import { elementsOf, NO_ELEMENTS, pathOf, targetsFor, type BpmnElements } from "../diagram/elements";
import { marksOfProcess, withPicked, withTargets, withWaiting } from "../diagram/marks";
import { useMarkWords } from "../diagram/words";
import { Acts } from "../incidents/Acts";
import { Retries } from "../incidents/Retries";
import { Incidents, type Moving } from "../incidents/Incidents";
import { Reservations } from "../incidents/Reservations";
import { waitingReasons } from "../incidents/waiting";
import { taskMark } from "../names";
import { useBpmn, useProcess } from "../records";
import { TasksBar } from "../timeline/TasksBar";
import { TasksView } from "../timeline/TasksView";
import { ProcessHead } from "./ProcessHead";
import { TaskPanel } from "./TaskPanel";
import { ProcessComments } from "./ProcessComments";
import { Tokens } from "./Tokens";
import { Values } from "./Values";
import "./ProcessPanel.css";

const Diagram = lazy(() => import("../diagram/Diagram"));

export const VIEWS = ["timeline", "table", "tokens", "values", "acts", "comments"] as const;
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
  const [view, setView] = useChoice<View>("view", VIEWS, "timeline");
  const [picked, setPicked] = useQueryParameter("task");
  const change = useQueryChange();
  const task = process.tasks.find((one) => taskMark(one) === picked) ?? null;
  const bpmn = useBpmn(process.definition, process.version);
  const elements = useMemo(() => (bpmn.value === null ? NO_ELEMENTS : elementsOf(bpmn.value)), [bpmn.value]);
  const { moving, setMoving, setTarget } = useMoving(process, elements);
  const pick = (element: string | null) => {
    const last = process.tasks.findLast((one) => one.element === element);
    setPicked(last === undefined ? "" : taskMark(last));
  };
  const showsTasks = view === "timeline" || view === "table";
  return (
    <div className="process">
      <ProcessHead process={process} />
      <Incidents
        process={process}
        elements={elements}
        moving={moving}
        onMove={setMoving}
        onTarget={setTarget}
        onPick={({ element }) => pick(element)}
      />
      <Retries process={process} elements={elements} />
      <Reservations process={process} elements={elements} onPick={pick} />
      <ProcessDiagram
        process={process}
        bpmn={bpmn}
        elements={elements}
        moving={moving}
        picked={task?.element ?? null}
        onPick={(element) => {
          if (moving === null) pick(element);
          else if (element !== null && moving.isDrawn && moving.targets.some(({ id }) => id === element)) setTarget(element);
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
          {showsTasks && <TasksBar process={process} />}
        </div>
        <div className="process__below">
          {view === "tokens" && (
            <Tokens
              process={process}
              elements={elements}
              onPick={(mark) => change({ view: "", task: mark })}
            />
          )}
          {view === "values" && <Values process={process} />}
          {view === "acts" && <Acts process={process} elements={elements} />}
          {view === "comments" && <ProcessComments id={process.id} />}
          {showsTasks && <TasksView process={process} view={view} picked={picked} onPick={setPicked} />}
          {task === null && picked !== "" && <UnknownName thing="task" name={picked} parameter="task" />}
          {task !== null && showsTasks && (
            <TaskPanel process={process} task={task} onClose={() => setPicked("")} />
          )}
        </div>
      </section>
    </div>
  );
}

/** The token that is being moved; the choice ends when the token has no incident any more. */
function useMoving(process: ProcessView, elements: BpmnElements) {
  const [token, setToken] = useState<string | null>(null);
  const [to, setTarget] = useState("");
  const incident = process.incidents.find((one) => one.token === token);
  const { drawn, inner } = pathOf(elements, incident?.element ?? "");
  const called = useCalledElements(inner === null ? null : (elements.get(drawn)?.calls ?? null));
  const targets = inner === null ? targetsFor(elements, drawn) : targetsFor(called, inner);
  const moving: Moving | null = incident === undefined ? null : { incident, targets, isDrawn: inner === null, to };
  const setMoving = (one: IncidentView | null) => {
    setToken(one?.token ?? null);
    setTarget("");
  };
  return { moving, setMoving, setTarget };
}

/** The elements of a called process, in its latest version. */
function useCalledElements(name: string | null): BpmnElements {
  const { value } = useBpmn(name ?? "", name === null ? null : "newest");
  return useMemo(() => (value === null ? NO_ELEMENTS : elementsOf(value)), [value]);
}

interface ProcessDiagramProps {
  process: ProcessView;
  bpmn: ServiceQuery<string>;
  elements: BpmnElements;
  moving: Moving | null;
  picked: string | null;
  onPick: (element: string | null) => void;
}

function ProcessDiagram({ process, bpmn, elements, moving, picked, onPick }: ProcessDiagramProps) {
  const { t } = useTranslation("processes");
  const words = useMarkWords("process");
  const { waiting, elements: counts, incidents, tokens } = process;
  const reasons = waitingReasons(process, (element) => pathOf(elements, element).drawn);
  const reasonsKey = JSON.stringify([...reasons]);
  const drawn = moving?.isDrawn === true ? moving : null;
  const to = drawn === null || drawn.to === "" ? picked : drawn.to;
  const targets = drawn?.targets.map(({ id }) => id).join(" ") ?? "";
  const marks = useMemo(() => {
    const own = marksOfProcess({ waiting, elements: counts, incidents, tokens }, words, (element) => pathOf(elements, element).drawn);
    const waits = new Map(JSON.parse(reasonsKey) as [string, string][]);
    return withPicked(withTargets(withWaiting(own, waits), targets === "" ? [] : targets.split(" ")), to);
  }, [waiting, counts, incidents, tokens, words, elements, targets, to, reasonsKey]);
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
