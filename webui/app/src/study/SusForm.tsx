/** The SUS questionnaire: ten statements with five large options each; all must be answered. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Label, RadioGroup } from "react-aria-components";
import { Button } from "~/design/Button";
import { RadioOption } from "~/design/RadioOption";
import type { StepProps } from "./Participant";

const places = [1, 2, 3, 4, 5] as const;

export function SusForm({ words, session, answer, busy }: StepProps) {
  const { t } = useTranslation("study", { lng: session.language });
  const { sus } = words;
  const [answers, setAnswers] = useState<readonly (number | null)[]>(() => sus.items.map(() => null));
  const open = answers.filter((answer) => answer === null).length;
  const set = (index: number, value: string) => setAnswers(answers.map((answer, other) => (other === index ? Number(value) : answer)));
  const nameOf = (place: number) => (place === 1 ? `1, ${sus.disagree}` : place === 5 ? `5, ${sus.agree}` : String(place));
  return (
    <>
      <h1>{sus.title}</h1>
      <p className="participant__text">{sus.ask}</p>
      <ol className="questions">
        {sus.items.map((item, index) => (
          <li key={item}>
            <RadioGroup orientation="horizontal" value={answers[index]?.toString() ?? null} onChange={(value) => set(index, value)}>
              <Label>
                {index + 1}. {item}
              </Label>
              <div className="questions__places">
                <span aria-hidden>{sus.disagree}</span>
                {places.map((place) => (
                  <RadioOption key={place} value={String(place)} className="questions__place" label={nameOf(place)}>
                    {place}
                  </RadioOption>
                ))}
                <span aria-hidden>{sus.agree}</span>
              </div>
            </RadioGroup>
          </li>
        ))}
      </ol>
      <div className="participant__actions">
        <Button kind="main" size="large" isDisabled={busy || open > 0} onPress={() => answer({ answers })}>
          {t("next")}
        </Button>
        {open > 0 && <p role="status">{t("open", { count: open })}</p>}
      </div>
      <p className="participant__source">{t("source", { source: sus.source })}</p>
    </>
  );
}
