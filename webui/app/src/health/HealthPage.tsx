/** Health: the body signals of a person who consents, what follows for robots, and what is recorded. */
import { HeartPulse, UserPlus } from "lucide-react";
import { useMemo, useState, useSyncExternalStore } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import type { PersonView } from "~/api/generated/human-state";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Loading } from "~/design/Loading";
import { Select } from "~/design/Select";
import { useNow } from "~/live/clock";
import { shortName } from "~/live/urn";
import { addresses } from "~/places/addresses";
import { UnknownName } from "~/route/UnknownName";
import { useQueryParameter } from "~/route/queryParameter";
import { mayDo, useSession } from "~/session/session";
import { AccessCard } from "./AccessCard";
import { ActivityCard } from "./ActivityCard";
import { BaselineCard } from "./BaselineCard";
import { ConsentForm } from "./ConsentForm";
import { consents, SERVICE, SILENT_S } from "./health";
import { HistoryCard } from "./HistoryCard";
import { LimitCard } from "./LimitCard";
import { LiveSignals } from "./liveSignals";
import { PressureCard } from "./PressureCard";
import { RecordedCard } from "./RecordedCard";
import { RecordingsCard } from "./RecordingsCard";
import { SensorsCard } from "./SensorsCard";
import { VitalSigns } from "./VitalSigns";
import { Waveforms } from "./Waveforms";
import "./HealthPage.css";

const PEOPLE_EVERY_MS = 5000;

export default function HealthPage() {
  const { t } = useTranslation(["health", "devices", "system", "common"]);
  const { value: people, failure, reload } = useServiceQuery<PersonView[]>(SERVICE, "people", { intervalMs: PEOPLE_EVERY_MS });
  const [asked, setAsked] = useQueryParameter("person");
  const [isAdding, setAdding] = useState(false);
  const person = people?.find(({ person: name }) => name === asked) ?? (asked === "" ? people?.[0] : undefined) ?? null;
  // Everybody may add oneself.
  const own = useSession().user?.person ?? null;
  const mayAdd = mayDo("configure") || (own !== null && people?.every(({ person: name }) => name !== shortName(own)) === true);
  const isNew = isAdding && mayAdd;
  return (
    <div className="health">
      <header className="health__head">
        <h1>{t("common:pages.health")}</h1>
        {people !== null && people.length > 0 && !isNew && (
          <Select
            label={t("person")}
            value={person?.person ?? ""}
            options={[...(person === null ? [{ value: "", name: t("choose") }] : []), ...people.map((each) => ({ value: each.person, name: `${each.person} · ${each.pseudonym}` }))]}
            onChange={setAsked}
          />
        )}
        {mayAdd && people !== null && !isNew && (
          <Button icon={<UserPlus aria-hidden size={18} />} onPress={() => setAdding(true)}>
            {t("add")}
          </Button>
        )}
      </header>
      <p className="health__notice small quiet">{t("notMedical")}</p>
      {failure !== null && <ErrorMessage act={<Link href={addresses.services()}>{t("toSystem")}</Link>}>{failure}</ErrorMessage>}
      {isNew ? (
        <ConsentForm
          person={null}
          name={mayDo("configure") || own === null ? "" : shortName(own)}
          onDone={(name) => {
            setAdding(false);
            setAsked(name);
            reload();
          }}
          onCancel={() => setAdding(false)}
        />
      ) : people === null ? (
        failure === null && <Loading />
      ) : people.length === 0 && asked === "" ? (
        <EmptyState icon={<HeartPulse aria-hidden size={32} />} title={t("none.title")}>
          {t(mayAdd ? "none.means" : "none.ask")}
        </EmptyState>
      ) : person === null ? (
        <UnknownName thing="person" name={asked} parameter="person">{t("noPerson")}</UnknownName>
      ) : (
        <Person key={person.person} person={person} onChange={reload} onDelete={() => setAsked("")} />
      )}
    </div>
  );
}

/** Without consent there is the form of the consent, and nothing of the body. */
function Person({ person, onChange, onDelete }: { person: PersonView; onChange: () => void; onDelete: () => void }) {
  const [isChanging, setChanging] = useState(false);
  const done = () => {
    setChanging(false);
    onChange();
  };
  return (
    <>
      <RecordedCard person={person} onChange={onChange} onChangeConsent={() => setChanging(true)} onDeletePerson={onDelete} />
      {(isChanging || !consents(person)) && <ConsentForm person={person} onDone={done} {...(isChanging ? { onCancel: () => setChanging(false) } : {})} />}
      {consents(person) && <Body person={person} onChange={onChange} />}
      <AccessCard person={person} />
    </>
  );
}

function Body({ person, onChange }: { person: PersonView; onChange: () => void }) {
  const { t } = useTranslation("health");
  const signals = useMemo(() => new LiveSignals(person.person), [person.person]);
  const live = useSyncExternalStore(signals.subscribe, signals.snapshot);
  const { state, receivedMs } = live;
  const silentS = Math.max(0, (useNow() - receivedMs) / 1000);
  const limit = state?.limit ?? person.limit;
  return (
    <div className="health__body">
      <VitalSigns state={state} silentS={silentS} isOld={state !== null && silentS > SILENT_S} />
      <div className="health__side">
        {limit === null ? <p className="health__note quiet small">{t("limit.noConsent")}</p> : <LimitCard person={person} limit={limit} onChange={onChange} />}
        <SensorsCard person={person} onChange={onChange} />
        <BaselineCard person={person} onChange={onChange} />
      </div>
      <Waveforms signals={signals} waves={live.waves} />
      <ActivityCard person={person} state={state} silentS={silentS} />
      {live.maps.map((map) => (
        <PressureCard key={map.sensor} map={map} />
      ))}
      <div className="health__wide">
        <HistoryCard person={person} />
      </div>
      <div className="health__wide">
        <RecordingsCard person={person} onChange={onChange} />
      </div>
    </div>
  );
}
