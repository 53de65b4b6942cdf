/** The heart rates at rest and at most: by age, given, or measured now. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { PersonView } from "~/api/generated/human-state";
import { errorText, requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { number } from "~/design/numbers";
import { mayDo } from "~/session/session";
import { pathOf, SERVICE } from "./health";

const MEASURED = ["rest", "maximum"] as const;

export function BaselineCard({ person, onChange }: { person: PersonView; onChange: () => void }) {
  const { t, i18n } = useTranslation("health");
  const [failure, setFailure] = useState<string | null>(null);
  const bpm = (value: number) => number(value, i18n.language, { maximumFractionDigits: 0 });
  const measure = async (what: (typeof MEASURED)[number]) => {
    setFailure(null);
    try {
      await requestService(SERVICE, `${pathOf(person.person)}/baseline/${what}`, { method: "POST" });
      onChange();
    } catch (error) {
      setFailure(errorText(error));
    }
  };
  return (
    <Card title={t("baseline.title")}>
      <p>
        {t("baseline.means", {
          rest: bpm(person.restBpm),
          maximum: bpm(person.maximumBpm),
          method: t(`baseline.method.${person.baselineMethod}`, { defaultValue: person.baselineMethod }),
        })}
      </p>
      {mayDo("configure") &&
        MEASURED.map((what) => (
          <div key={what} className="health__measure">
            <Button onPress={() => void measure(what)}>{t(`baseline.${what}`)}</Button>
            <span className="quiet small">{t(`baseline.${what}Means`)}</span>
          </div>
        ))}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </Card>
  );
}
