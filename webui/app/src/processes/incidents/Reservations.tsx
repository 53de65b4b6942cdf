/** What is reserved for a process, and what it waits for: since when, why, and how it is released. */
import { Hourglass, Lock, LockOpen } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { releaseReservation } from "~/api/actions";
import { Button } from "~/design/Button";
import { RelativeTime } from "~/design/RelativeTime";
import { useSourceName } from "~/alerts/titles";
import { eventText, inWords } from "~/i18n/server";
import type { ProcessView, ReservationView } from "~/api/generated/task-orchestrator";
import { elementName, type BpmnElements } from "../diagram/elements";
import { MendDialog } from "./MendDialog";
import { liveReservations, waitingActivities } from "./waiting";
import "./Reservations.css";

export interface ReservationsProps {
  process: ProcessView;
  elements: BpmnElements;
  onPick: (element: string) => void;
}

export function Reservations({ process, elements, onPick }: ReservationsProps) {
  const { t } = useTranslation("processes");
  const sourceOf = useSourceName();
  const [asking, setAsking] = useState<ReservationView | null>(null);
  const reservations = liveReservations(process);
  const waiting = waitingActivities(process);
  if (reservations.length + waiting.length === 0) return null;
  const reasonOf = (each: { reason: string | null }) => {
    const said = eventText(each, "reason");
    if (said === null) return null;
    const { process: holder } = said.parameters;
    return inWords(typeof holder === "string" ? { ...said, parameters: { ...said.parameters, process: sourceOf(holder) } } : said);
  };
  const nameAt = ({ element, name }: { element: string; name: string }) => {
    if (element === process.definition) return process.title;
    return name === "" ? elementName(elements, element) : name;
  };
  return (
    <ul className="reservations" aria-label={t("reservation.list")}>
      {waiting.map((each) => (
        <li key={each.token} className="reservation reservation--waiting">
          <Hourglass aria-hidden size={18} />
          <p>
            <button type="button" className="reservation__where" onClick={() => onPick(each.element)}>
              {nameAt(each)}
            </button>{" "}
            {t("reservation.waits", { why: reasonOf(each) })} <Since at={each.since} />
          </p>
        </li>
      ))}
      {reservations.map((each) => (
        <li key={each.key} className={`reservation reservation--${each.state}`}>
          {each.state === "held" ? <Lock aria-hidden size={18} /> : <Hourglass aria-hidden size={18} />}
          <p>
            <button type="button" className="reservation__where" onClick={() => onPick(each.element)}>
              {nameAt(each)}
            </button>{" "}
            {each.state === "held"
              ? t("reservation.held", { agents: each.agents.map(lastPart).join(", ") })
              : t(each.state === "waiting" ? "reservation.waits" : "reservation.stopped", { why: reasonOf(each) })}{" "}
            <Since at={each.since} />
            {each.state === "held" && process.incidents.length > 0 && (
              <span className="reservation__note"> {t("reservation.keeps")}</span>
            )}
          </p>
          {each.state === "held" && (
            <Button permission="runProcesses" icon={<LockOpen aria-hidden size={18} />} onPress={() => setAsking(each)}>
              {t("reservation.release")}
            </Button>
          )}
        </li>
      ))}
      {asking !== null && (
        <MendDialog
          title={t("reservation.title", { agents: asking.agents.map(lastPart).join(", ") })}
          act={t("reservation.act")}
          means={t("reservation.means")}
          kind="stop"
          onClose={() => setAsking(null)}
          onAct={(decision) => releaseReservation(process.id, asking.key, decision)}
        />
      )}
    </ul>
  );
}

function Since({ at }: { at: string }) {
  return (
    <span className="quiet small">
      <RelativeTime at={at} isStop />
    </span>
  );
}

function lastPart(urn: string): string {
  return urn.slice(urn.lastIndexOf(":") + 1);
}
