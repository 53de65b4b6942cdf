/** The consent of a person: for what, until when, and who was there. The first one adds the person. */
import { ShieldCheck } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { ConsentGiven, PersonView, Purpose } from "~/api/generated/human-state";
import { errorText, requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { Checkbox } from "~/design/Checkbox";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { useNow } from "~/live/clock";
import { userName } from "~/shell/userName";
import { consentFaults, consents, consentState, dateText, DAY_MS, DEFAULT_CONSENT_DAYS, endOfDay, MAX_CONSENT_DAYS, pathOf, PURPOSES, SERVICE } from "./health";

interface ConsentFormProps {
  /** Null for a new person. */
  person: PersonView | null;
  /** The name that a new person has at first. */
  name?: string;
  onDone: (name: string) => void;
  onCancel?: () => void;
}

export function ConsentForm({ person, name = "", onDone, onCancel }: ConsentFormProps) {
  const { t } = useTranslation(["health", "common"]);
  const now = useNow();
  const [fields, setFields] = useState(() => ({ name: person?.person ?? name, age: "", ends: dateText(now + DEFAULT_CONSENT_DAYS * DAY_MS), givenBy: userName() }));
  const [purposes, setPurposes] = useState<readonly Purpose[]>(person !== null && consents(person) ? person.purposes : ["live"]);
  const [showsFaults, setShowsFaults] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const [isBusy, setBusy] = useState(false);
  const isNew = person === null;
  const change = (part: Partial<typeof fields>) => setFields({ ...fields, ...part });
  const send = async () => {
    const faults = consentFaults(fields, isNew, now);
    setShowsFaults(true);
    const ends = endOfDay(fields.ends);
    if (Object.keys(faults).length > 0 || ends === null) return;
    setBusy(true);
    setFailure(null);
    try {
      if (isNew) await requestService(SERVICE, pathOf(fields.name), { method: "PUT", json: { age: Number(fields.age.replace(",", ".")) } });
      const json: ConsentGiven = { purposes: [...purposes], ends, givenBy: fields.givenBy.trim() };
      await requestService(SERVICE, `${pathOf(fields.name)}/consent`, { method: "PUT", json });
      onDone(fields.name);
    } catch (error) {
      setFailure(errorText(error));
    } finally {
      setBusy(false);
    }
  };
  const faults = showsFaults ? consentFaults(fields, isNew, now) : {};
  const fault = (field: keyof typeof fields) => (faults[field] === true ? t(`consent.fault.${field}`, { days: MAX_CONSENT_DAYS }) : undefined);
  const why = person === null ? "new" : consentState(person);
  return (
    <Card title={t("consent.title")} className="health__consent">
      <p>{t(`consent.why.${why}`)}</p>
      {person !== null && <p>{t("consent.pseudonym", { pseudonym: person.pseudonym })}</p>}
      <form
        className="health__form"
        onSubmit={(event) => {
          event.preventDefault();
          if (!isBusy) void send();
        }}
      >
        {isNew && (
          <div className="health__fields">
            <Field label={t("consent.name")} hint={t("consent.nameHint")} value={fields.name} onChange={(text) => change({ name: text })} error={fault("name")} />
            <Field label={t("consent.age")} hint={t("consent.ageHint")} value={fields.age} onChange={(age) => change({ age })} inputMode="decimal" error={fault("age")} />
          </div>
        )}
        <fieldset className="health__purposes">
          <legend>{t("consent.purposes")}</legend>
          {PURPOSES.map((purpose) =>
            purpose === "live" ? (
              <p key={purpose}>
                <ShieldCheck aria-hidden size={18} /> {t("purpose.live")} <span className="quiet small">{t("consent.always")}</span>
              </p>
            ) : (
              <Checkbox key={purpose} isSelected={purposes.includes(purpose)} onChange={(isOn) => setPurposes(isOn ? [...purposes, purpose] : purposes.filter((each) => each !== purpose))}>
                {t(`purpose.${purpose}`)}
              </Checkbox>
            ),
          )}
        </fieldset>
        <div className="health__fields">
          <Field label={t("consent.ends")} type="date" value={fields.ends} onChange={(ends) => change({ ends })} error={fault("ends")} />
          <Field label={t("consent.givenBy")} hint={t("consent.givenByHint")} value={fields.givenBy} onChange={(givenBy) => change({ givenBy })} error={fault("givenBy")} />
        </div>
        <p className="quiet small">{t("consent.withdrawable")}</p>
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        <div className="health__acts">
          <Button type="submit" kind="main" isDisabled={isBusy}>
            {t("consent.give")}
          </Button>
          {onCancel !== undefined && <Button onPress={onCancel}>{t("common:leaveIt")}</Button>}
        </div>
      </form>
    </Card>
  );
}
