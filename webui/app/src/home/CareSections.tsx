/** People in care, and the exercises that run. */
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import type { MachineView } from "~/api/generated/assistive-devices";
import type { PersonView } from "~/api/generated/human-state";
import type { SessionView } from "~/api/generated/whole-body-control";
import { useServiceQuery, type ServiceQuery } from "~/api/useServiceQuery";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Loading } from "~/design/Loading";
import { percent } from "~/design/numbers";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { consents, limitTone, sensorFault } from "~/health/health";
import { addresses } from "~/places/addresses";
import { Section } from "./Section";

const POLL_INTERVAL_MS = 5000;

export function CareSection() {
  const { t } = useTranslation("home");
  const people = useServiceQuery<PersonView[]>("human-state", "people", { intervalMs: POLL_INTERVAL_MS });
  if (people.value === null) return <Waiting title={t("care.title")} of={people} />;
  return (
    <Section title={t("care.title")} all={people.value} href={addresses.health()} none={t("care.none")}>
      {(person) => (
        <li key={person.person}>
          <Link href={addresses.health({ person: person.person })}>{person.person}</Link>
          <PersonState person={person} />
        </li>
      )}
    </Section>
  );
}

function PersonState({ person }: { person: PersonView }) {
  const { t, i18n } = useTranslation("home");
  const { limit } = person;
  const faults = person.sensors.filter((sensor) => sensorFault(sensor) !== null).length;
  if (!consents(person)) return <StatusBadge tone="neutral">{t("care.noConsent")}</StatusBadge>;
  return (
    <>
      {limit !== null && (
        <StatusBadge tone={limitTone(limit)}>{limit.isStopped ? t("care.stopped") : limit.fraction < 1 ? t("care.limited", { share: percent(limit.fraction, i18n.language) }) : t("care.unlimited")}</StatusBadge>
      )}
      {faults > 0 && <StatusBadge tone="attention">{t("care.sensors", { count: faults })}</StatusBadge>}
      {limit === null && faults === 0 && <span className="quiet small">{t("care.watched")}</span>}
    </>
  );
}

export function ExercisesSection({ services }: { services: readonly string[] }) {
  const { t } = useTranslation(["home", "cases", "humanoid"]);
  const sessions = useServiceQuery<SessionView[]>("whole-body-control", services.includes("whole-body-control") ? "sessions" : null, { intervalMs: POLL_INTERVAL_MS });
  const machines = useServiceQuery<MachineView[]>("assistive-devices", services.includes("assistive-devices") ? "machines" : null, { intervalMs: POLL_INTERVAL_MS });
  const failure = sessions.failure ?? machines.failure;
  const asked = [...(services.includes("whole-body-control") ? [sessions] : []), ...(services.includes("assistive-devices") ? [machines] : [])];
  const running = (sessions.value ?? []).filter(({ endedAt }) => endedAt === null);
  const [last] = [...(sessions.value ?? [])].filter(({ endedAt }) => endedAt !== null).sort((a, b) => (a.startedAt > b.startedAt ? -1 : 1));
  const active = (machines.value ?? []).filter(({ isMoving, problem, trial }) => isMoving || problem !== "" || trial?.isRunning === true);
  const sessionName = ({ application, person }: SessionView) => [t(`humanoid:application.${application}`, { defaultValue: application }), person].filter(Boolean).join(" · ");
  return (
    <Card className="home__section" title={t("exercises.title")} aside={<span className="home__count">{running.length + active.length}</span>}>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {failure === null && asked.some(({ value }) => value === null) && <Loading />}
      {failure === null && running.length + active.length === 0 && asked.every(({ value }) => value !== null) && <p className="quiet">{t("exercises.none")}</p>}
      <ul className="home__list">
        {running.map((session) => (
          <li key={session.id}>
            <Link href={addresses.humanoid()}>{sessionName(session)}</Link>
            <StatusBadge tone="accent">{t("exercises.running")}</StatusBadge>
            <span className="quiet small">
              <RelativeTime at={session.startedAt} />
            </span>
          </li>
        ))}
        {active.map((machine) => (
          <li key={machine.case}>
            <Link href={addresses.cases({ case: machine.case })}>
              {t(`cases:name.${machine.case}`, { defaultValue: machine.case })} · {machine.person}
            </Link>
            <StatusBadge tone={machine.problem !== "" ? "stop" : "accent"}>{t(`cases:state.${machine.state}`, { defaultValue: machine.state })}</StatusBadge>
          </li>
        ))}
        {running.length === 0 && last !== undefined && (
          <li>
            <Link href={addresses.humanoid()}>{t("exercises.last", { session: sessionName(last) })}</Link>
            <span className="quiet small">
              <RelativeTime at={last.startedAt} />
            </span>
          </li>
        )}
      </ul>
    </Card>
  );
}

function Waiting({ title, of }: { title: string; of: ServiceQuery<unknown> }) {
  return (
    <Card className="home__section" title={title}>
      {of.failure === null ? <Loading /> : <ErrorMessage>{of.failure}</ErrorMessage>}
    </Card>
  );
}
