/** The list at the left: what can run, what runs, what has run. It keeps its place while somebody is in it. */
import { FileUp, Play } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { Ago } from "~/design/Ago";
import { Button } from "~/design/Button";
import { Field } from "~/design/Field";
import { Problem } from "~/design/Problem";
import { State } from "~/design/State";
import { statusTone } from "~/design/states";
import { useFamily } from "~/live/hooks";
import type { DefinitionView } from "~/live/messages";
import { useQuery } from "~/route/query";
import { pathOf, samePlace, type Place } from "../address";
import { markOf } from "../names";
import { useHistory } from "./history";
import { found, foundDefinitions, held, sameSections, type ProcessRow, type Sections } from "./rows";
import "./ProcessList.css";

export interface ProcessListProps {
  place: Place;
  onStart: (definition: DefinitionView) => void;
  onUpload: () => void;
}

export function ProcessList({ place, onStart, onUpload }: ProcessListProps) {
  const { t } = useTranslation(["processes", "common"]);
  const [find, setFind] = useQuery("find");
  const definitions = foundDefinitions(useFamily("definition"), find);
  const history = useHistory();
  const { sections, waiting, hold, release } = useHeld(history.sections, place.kind === "process" ? place.id : null);
  const said = (status: ProcessRow["status"]) => t(`common:status.${status}`);
  const running = found(sections.running, find, said);
  const ended = found(sections.ended, find, said);
  return (
    <aside
      className="process-list"
      aria-label={t("list.label")}
      onPointerEnter={() => hold("pointer")}
      onPointerLeave={() => release("pointer")}
      onFocus={() => hold("focus")}
      onBlur={(event) => {
        if (!event.currentTarget.contains(event.relatedTarget)) release("focus");
      }}
    >
      <div className="process-list__head">
        <Field label={t("list.find")} type="search" value={find} onChange={setFind} />
        <Button icon={<FileUp aria-hidden size={18} />} onPress={onUpload}>
          {t("list.upload")}
        </Button>
      </div>
      <div className="process-list__rows" tabIndex={-1}>
        {history.failure !== null && <Problem>{t("list.unread", { why: history.failure })}</Problem>}
        <Section title={t("list.definitions", { count: definitions.length })} empty={t(find === "" ? "list.noDefinitions" : "list.notFound")}>
          {definitions.map((definition) => (
            <li key={definition.name} className="process-list__row">
              <Row to={{ kind: "definition", name: definition.name }} here={place} find={find}>
                <span className="process-list__title">{definition.title}</span>
                <span className="process-list__more">
                  {definition.unusable === undefined ? (
                    t("version", { version: definition.version })
                  ) : (
                    <State tone="stop">{t("list.unusable")}</State>
                  )}
                </span>
              </Row>
              {definition.unusable === undefined && (
                <Button
                  kind="quiet"
                  label={t("start.act", { title: definition.title })}
                  icon={<Play aria-hidden size={18} />}
                  onPress={() => onStart(definition)}
                />
              )}
            </li>
          ))}
        </Section>
        <Section title={t("list.running", { count: running.length })} empty={t(find === "" ? "list.noneRuns" : "list.notFound")}>
          {running.map((row) => (
            <ProcessItem key={row.id} row={row} here={place} find={find} />
          ))}
        </Section>
        <Section title={t("list.ended", { count: ended.length })} empty={t(find === "" ? "list.noneEnded" : "list.notFound")}>
          {ended.map((row) => (
            <ProcessItem key={row.id} row={row} here={place} find={find} />
          ))}
        </Section>
        {history.more && (
          <Button kind="quiet" onPress={history.older}>
            {t("list.older")}
          </Button>
        )}
      </div>
      {waiting > 0 && (
        <div className="process-list__news">
          <Button onPress={() => release("all")}>{t("list.news", { count: waiting })}</Button>
        </div>
      )}
    </aside>
  );
}

function Section({ title, empty, children }: { title: string; empty: string; children: React.ReactNode[] }) {
  return (
    <section className="process-list__section">
      <h2>{title}</h2>
      {children.length === 0 ? <p className="quiet small">{empty}</p> : <ul>{children}</ul>}
    </section>
  );
}

function ProcessItem({ row, here, find }: { row: ProcessRow; here: Place; find: string }) {
  const { t } = useTranslation(["processes", "common"]);
  return (
    <li className="process-list__row">
      <Row to={{ kind: "process", id: row.id }} here={here} find={find}>
        <span className="process-list__title">{row.title}</span>
        <span className="process-list__more">
          <State tone={statusTone[row.status]}>{t(`common:status.${row.status}`)}</State>
          <span className="quiet">{markOf(row)}</span>
        </span>
      </Row>
      <span className="process-list__time small quiet">
        <Ago at={row.endedAt ?? row.startedAt} />
      </span>
    </li>
  );
}

function Row({ to, here, find, children }: { to: Place; here: Place; find: string; children: React.ReactNode }) {
  const query = find === "" ? "" : `?find=${encodeURIComponent(find)}`;
  return (
    <Link href={`${pathOf(to)}${query}`} className="process-list__link" aria-current={samePlace(to, here) ? "page" : undefined}>
      {children}
    </Link>
  );
}

type Reason = "pointer" | "focus";

/**
 * The list as it is shown: held in place from the moment somebody is in it until they have left. A process
 * that is opened shows up at once: whoever has started it looks for it.
 */
function useHeld(now: Sections, opened: string | null) {
  const [reasons, setReasons] = useState<readonly Reason[]>([]);
  const [kept, setKept] = useState(now);
  const isHeld = reasons.length > 0;
  // What was read into an empty list is no news that could move anything.
  const first = (kept.running.length + kept.ended.length === 0) || (has(now, opened) && !has(kept, opened));
  if ((!isHeld || first) && !sameSections(kept, now)) setKept(now);
  const { sections, waiting } = isHeld && !first ? held(kept, now) : { sections: now, waiting: 0 };
  const hold = (reason: Reason) => setReasons((all) => (all.includes(reason) ? all : [...all, reason]));
  const release = (reason: Reason | "all") => {
    if (reason === "all") setKept(now);
    else setReasons((all) => all.filter((one) => one !== reason));
  };
  return { sections, waiting, hold, release };
}

function has(sections: Sections, id: string | null): boolean {
  return [...sections.running, ...sections.ended].some((row) => row.id === id);
}
