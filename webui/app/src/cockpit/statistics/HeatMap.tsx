/** The drawing of a definition, coloured by durations or counts, with open Tasks and incidents. */
import { lazy, Suspense, useMemo } from "react";
import { useTranslation } from "react-i18next";
import type { CauseView, ElementTimes } from "~/api/generated/task-orchestrator";
import { ErrorMessage } from "~/design/ErrorMessage";
import { number } from "~/design/numbers";
import { Select } from "~/design/Select";
import { duration } from "~/design/times";
import { useTopic } from "~/live/hooks";
import { withPicked } from "~/processes/diagram/marks";
import { useBpmn } from "~/processes/records";
import { useChoice } from "~/route/choice";
import type { Scope } from "../query";
import { HEATS, heatMarks, isDuration, MEASURES, scaleOf, type HeatWords, type Measure } from "./heat";

const Diagram = lazy(() => import("~/processes/diagram/Diagram"));

export interface HeatMapProps {
  scope: Scope;
  title: string;
  elements: readonly ElementTimes[];
  causes: readonly CauseView[];
  picked: string;
  onPick: (element: string) => void;
}

export function HeatMap({ scope, title, elements, causes, picked, onPick }: HeatMapProps) {
  const { t, i18n } = useTranslation(["cockpit", "processes"]);
  const [measure, setMeasure] = useChoice("heat", MEASURES, "meanMs");
  const latest = useTopic(`definition/${scope.definition}`);
  const version = scope.version === "" ? (latest?.version ?? null) : Number(scope.version);
  const bpmn = useBpmn(scope.definition, version);
  const words: HeatWords = useMemo(() => {
    const value = (of: number) => (isDuration(measure) ? duration(of, i18n.language) : number(of, i18n.language));
    return {
      value,
      measured: (of) => `${t(`measure.${measure}`)}: ${of}`,
      open: ({ waiting, working, paused }) => t("open", { waiting, working, paused }),
      incidents: (count) => t("incidents", { count }),
    };
  }, [t, i18n.language, measure]);
  const marks = useMemo(() => withPicked(heatMarks(elements, causes, measure, words), picked === "" ? null : picked), [elements, causes, measure, words, picked]);
  return (
    <section className="heat" aria-label={t("heat.label", { title })}>
      <header className="heat__bar">
        <Select label={t("heat.measure")} value={measure} options={MEASURES.map((value) => ({ value, name: t(`measure.${value}`) }))} onChange={setMeasure} />
        <Legend elements={elements} measure={measure} words={words} />
      </header>
      <div className="heat__diagram">
        {bpmn.failure !== null && <ErrorMessage>{t("processes:diagram.unread", { why: bpmn.failure })}</ErrorMessage>}
        {bpmn.value !== null && (
          <Suspense fallback={<p className="quiet">{t("processes:diagram.loading")}</p>}>
            <Diagram xml={bpmn.value} label={t("heat.label", { title })} marks={marks} onPick={(element) => onPick(element === picked ? "" : (element ?? ""))} />
          </Suspense>
        )}
      </div>
    </section>
  );
}

function Legend({ elements, measure, words }: { elements: readonly ElementTimes[]; measure: Measure; words: HeatWords }) {
  const { t } = useTranslation("cockpit");
  const scale = scaleOf(elements, measure);
  if (scale === null) return <p className="quiet">{t("heat.nothing")}</p>;
  return (
    <p className="heat__legend">
      {words.value(scale.least)}
      <span className="heat__scale" aria-hidden>
        {HEATS.map((heat) => (
          <span key={heat} className={`heat__step heat__step--${heat}`} />
        ))}
      </span>
      {words.value(scale.most)}
    </p>
  );
}
