/** The incidents of a process: what happened, where, since when, and how the step continues. */
import { ArrowRightLeft, Ban, Braces, SkipForward, TriangleAlert } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { cancelToken, moveToken, retryToken, skipToken } from "~/api/actions";
import type { IncidentView, MendRequest, ProcessView } from "~/api/generated/task-orchestrator";
import { Button } from "~/design/Button";
import { Field } from "~/design/Field";
import { RelativeTime } from "~/design/RelativeTime";
import { Select } from "~/design/Select";
import { localizedText } from "~/i18n/server";
import { sentence } from "~/live/readable";
import { elementName, type BpmnElement, type BpmnElements } from "../diagram/elements";
import { MendDialog } from "./MendDialog";
import { RetryButton } from "./RetryButton";
import "./Incidents.css";

/** A token that is being moved: the elements that can be chosen, and the chosen one ("" before). */
export interface Moving {
  incident: IncidentView;
  targets: readonly BpmnElement[];
  /** The targets are on the diagram; those of a called process are not. */
  isDrawn: boolean;
  to: string;
}

export interface IncidentsProps {
  process: ProcessView;
  elements: BpmnElements;
  moving: Moving | null;
  onMove: (incident: IncidentView | null) => void;
  onTarget: (element: string) => void;
  onPick: (incident: IncidentView) => void;
}

interface Asking {
  act: "retry" | "skip" | "cancel";
  incident: IncidentView;
}

export function Incidents({ process, elements, moving, onMove, onTarget, onPick }: IncidentsProps) {
  const { t } = useTranslation("processes");
  const [asking, setAsking] = useState<Asking | null>(null);
  if (process.incidents.length === 0) return null;
  return (
    <section className="incidents" aria-label={t("incident.list", { count: process.incidents.length })}>
      <ul>
        {process.incidents.map((incident) => (
          <li key={incident.token} className="incident">
            <TriangleAlert aria-hidden size={20} className="incident__icon" />
            <div className="incident__what">
              <p>
                <button type="button" className="incident__where" onClick={() => onPick(incident)}>
                  {incidentName(incident, elements)}
                </button>{" "}
                <span className="quiet small">
                  <RelativeTime at={incident.since} isStop />
                </span>
                {incident.code !== null && <span className="quiet small"> · {t("incident.code", { code: incident.code })}</span>}
              </p>
              <p className="incident__reason">{sentence(localizedText(incident, "reason") ?? "")}</p>
            </div>
            {moving?.incident.token === incident.token ? (
              <MovePanel process={process} moving={moving} elements={elements} onMove={onMove} onTarget={onTarget} />
            ) : (
              <div className="incident__acts">
                <RetryButton process={process} token={incident.token} step={incidentName(incident, elements)} kind="main" />
                <Button permission="runProcesses" icon={<Braces aria-hidden size={18} />} onPress={() => setAsking({ act: "retry", incident })}>
                  {t("incident.retryWith")}
                </Button>
                <Button permission="runProcesses" icon={<SkipForward aria-hidden size={18} />} onPress={() => setAsking({ act: "skip", incident })}>
                  {t("incident.skip")}
                </Button>
                <Button permission="runProcesses" icon={<ArrowRightLeft aria-hidden size={18} />} onPress={() => onMove(incident)}>
                  {t("incident.move")}
                </Button>
                <Button permission="runProcesses" icon={<Ban aria-hidden size={18} />} onPress={() => setAsking({ act: "cancel", incident })}>
                  {t("incident.cancel")}
                </Button>
              </div>
            )}
          </li>
        ))}
      </ul>
      {asking !== null && <Question process={process} elements={elements} asking={asking} onClose={() => setAsking(null)} />}
    </section>
  );
}

function Question({ process, elements, asking: { act, incident }, onClose }: { process: ProcessView; elements: BpmnElements; asking: Asking; onClose: () => void }) {
  const { t } = useTranslation("processes");
  const step = incidentName(incident, elements);
  const does = { retry: retryToken, skip: skipToken, cancel: cancelToken }[act];
  const variables = {
    retry: { label: t("mend.variables"), hint: t("mend.variablesHint"), before: process.variables },
    skip: { label: t("mend.results"), hint: t("mend.resultsHint"), before: {} },
    cancel: null,
  }[act];
  return (
    <MendDialog
      title={t(`mend.${act}.title`, { step })}
      act={t(`mend.${act}.act`, { step })}
      means={t(`mend.${act}.means`)}
      kind={act === "retry" ? "main" : "stop"}
      {...(variables === null ? {} : { variables })}
      onClose={onClose}
      onAct={(decision) => does(process.id, incident.token, decision)}
    />
  );
}

interface MovePanelProps {
  process: ProcessView;
  moving: Moving;
  elements: BpmnElements;
  onMove: (incident: IncidentView | null) => void;
  onTarget: (element: string) => void;
}

/** Chooses where a token continues: on the diagram, in a list, or by its id where the file is not known. */
function MovePanel({ process, moving, elements, onMove, onTarget }: MovePanelProps) {
  const { t } = useTranslation("processes");
  const [asks, setAsks] = useState(false);
  const { incident, targets, to } = moving;
  const step = incidentName(incident, elements);
  const chosen = targets.find(({ id }) => id === to);
  const target = chosen === undefined ? to : chosen.name || chosen.id;
  const move = async (decision: MendRequest) => {
    await moveToken(process.id, incident.token, { ...decision, to });
    onMove(null);
  };
  return (
    <div
      className="incident__move"
      role="group"
      aria-label={t("mend.move.choose", { step })}
      onKeyDown={(event) => {
        if (event.key === "Escape" && !asks) onMove(null);
      }}
    >
      {targets.length > 0 ? (
        <Select
          label={t("mend.move.to")}
          value={to}
          options={[{ value: "", name: t(moving.isDrawn ? "mend.move.choose" : "mend.move.chooseHere", { step }) }, ...targets.map(({ id, name }) => ({ value: id, name: name === "" ? id : name === id ? name : `${name} (${id})` }))]}
          onChange={onTarget}
        />
      ) : (
        <Field label={t("mend.move.id")} value={to} onChange={onTarget} autoFocus />
      )}
      <Button kind="main" isDisabled={to.trim() === ""} onPress={() => setAsks(true)}>
        {t("incident.move")}
      </Button>
      <Button onPress={() => onMove(null)}>{t("mend.move.leave")}</Button>
      {asks && (
        <MendDialog
          title={t("mend.move.title", { step, target })}
          act={t("mend.move.act", { target })}
          means={t("mend.move.means")}
          kind="stop"
          onClose={() => setAsks(false)}
          onAct={move}
        />
      )}
    </div>
  );
}

/** What the step of an incident is called. */
export function incidentName({ name, element }: IncidentView, elements: BpmnElements): string {
  return name === "" ? elementName(elements, element) : name;
}
