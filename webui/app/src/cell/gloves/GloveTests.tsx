/** The accuracy tests of a glove, the latest first. */
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { exactTime } from "~/design/times";
import { shortName } from "~/live/urn";
import { addresses } from "~/places/addresses";
import { phaseTone, type TestSummary } from "~/test/tests";
import "../objects/ObjectHistory.css";

export default function GloveTests({ glove }: { glove: string }) {
  const { t, i18n } = useTranslation(["cell", "test"]);
  const { value: tests, failure } = useServiceQuery<TestSummary[]>("gesture-controller", "tests");
  const own = (tests ?? []).filter((test) => test.glove === glove);
  return (
    <Card title={t("history.tests")}>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {tests !== null && own.length === 0 && <p className="quiet">{t("history.noTests")}</p>}
      <ul className="object-history">
        {own.map((test) => (
          <li key={test.id}>
            <StatusBadge tone={phaseTone[test.phase] ?? "accent"}>{t(`test:phase.${test.phase}`)}</StatusBadge>
            <Link href={addresses.glove(glove, "test", { part: "accuracy", test: test.id })}>{exactTime(test.beganAt, i18n.language)}</Link>
            {test.person !== null && <span>{shortName(test.person)}</span>}
            <span className="quiet small">{t("test:earlier.size", { gestures: test.gestures.length, rounds: test.rounds })}</span>
          </li>
        ))}
      </ul>
    </Card>
  );
}
