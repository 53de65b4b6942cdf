/** The steps between the questionnaires: consent, introduction, tasks and preference. */
import { HardHat } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Label, RadioGroup, TextArea, TextField } from "react-aria-components";
import { useLocation } from "wouter";
import { Button } from "~/design/Button";
import { Field } from "~/design/Field";
import { RadioOption } from "~/design/RadioOption";
import { Checkbox } from "~/design/Checkbox";
import type { StepProps } from "./Participant";

export function Consent({ words, session, answer, busy }: StepProps) {
  const { consent } = words;
  const reply = (agreed: boolean) => answer({ agreed, text: session.consentVersion });
  return (
    <>
      <h1>{consent.title}</h1>
      {consent.text.map((paragraph) => (
        <p key={paragraph} className="participant__text">
          {paragraph}
        </p>
      ))}
      <div className="participant__actions">
        <Button kind="main" size="large" isDisabled={busy} onPress={() => reply(true)}>
          {consent.agree}
        </Button>
        <Button size="large" isDisabled={busy} onPress={() => reply(false)}>
          {consent.decline}
        </Button>
      </div>
    </>
  );
}

const experiences = ["low", "medium", "high"] as const;

export function About({ words, session, answer, busy }: StepProps) {
  const { t } = useTranslation("study", { lng: session.language });
  const [age, setAge] = useState("");
  const [experience, setExperience] = useState<string | null>(null);
  const years = age.trim() === "" ? null : Number(age);
  const isWrong = years !== null && !(Number.isInteger(years) && years >= 16 && years <= 120);
  return (
    <>
      <h1>{words.steps.introduction.title}</h1>
      <p className="participant__text">{words.steps.introduction.text}</p>
      <div className="participant__about">
        <Field
          size="large"
          label={words.introduction.age}
          value={age}
          onChange={setAge}
          inputMode="numeric"
          maxLength={3}
          error={isWrong ? t("ageWrong") : undefined}
        />
        <RadioGroup value={experience} onChange={setExperience} className="participant__choices">
          <Label>{words.introduction.experience}</Label>
          <div>
            {experiences.map((experience) => (
              <RadioOption key={experience} value={experience} className="participant__choice">
                {words.introduction[experience]}
              </RadioOption>
            ))}
          </div>
        </RadioGroup>
      </div>
      <div className="participant__actions">
        <Button kind="main" size="large" isDisabled={busy || isWrong} onPress={() => answer({ age_years: years, experience })}>
          {t("next")}
        </Button>
      </div>
    </>
  );
}

export function Task({ session, answer, busy, title, text }: StepProps & { title: string; text: string }) {
  const { t } = useTranslation("study", { lng: session.language });
  const [, go] = useLocation();
  const work = session.glove === null ? "/work" : `/work?glove=${encodeURIComponent(session.glove)}`;
  return (
    <>
      <h1>{title}</h1>
      <p className="participant__text">{text}</p>
      <p>
        <Button size="large" icon={<HardHat aria-hidden size={28} />} onPress={() => go(work)}>
          {t("openWork")}
        </Button>
      </p>
      <div className="participant__actions">
        <Button kind="main" size="large" isDisabled={busy} onPress={() => answer({ completed: true })}>
          {t("taskDone")}
        </Button>
        <Button size="large" isDisabled={busy} onPress={() => answer({ completed: false })}>
          {t("taskGivenUp")}
        </Button>
      </div>
    </>
  );
}

const preferences = ["personal", "predefined", "none"] as const;

export function Preference({ words, session, answer, busy }: StepProps) {
  const { t } = useTranslation("study", { lng: session.language });
  const [preferred, setPreferred] = useState<string | null>(null);
  const [recalibrated, setRecalibrated] = useState(false);
  const [comment, setComment] = useState("");
  return (
    <>
      <h1>{words.steps.preference.title}</h1>
      <RadioGroup aria-label={words.steps.preference.title} value={preferred} onChange={setPreferred} className="participant__choices">
        <div>
          {preferences.map((preference) => (
            <RadioOption key={preference} value={preference} className="participant__choice">
              {words.preference[preference]}
            </RadioOption>
          ))}
        </div>
      </RadioGroup>
      <Checkbox size="large" isSelected={recalibrated} onChange={setRecalibrated}>
        {words.preference.recalibrated}
      </Checkbox>
      <TextField value={comment} onChange={setComment} maxLength={4000} className="participant__comment">
        <Label>{words.preference.comment}</Label>
        <TextArea rows={4} />
      </TextField>
      <div className="participant__actions">
        <Button kind="main" size="large" isDisabled={busy || preferred === null} onPress={() => answer({ preferred, recalibrated, comment })}>
          {t("finish")}
        </Button>
      </div>
    </>
  );
}
