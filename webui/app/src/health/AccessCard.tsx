/** Who looked at the data of a person, or changed it: for the person, and for those who may read the audit log. */
import { Eye, Pencil } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { AccessView, PersonView } from "~/api/generated/human-state";
import { useServiceQuery } from "~/api/useServiceQuery";
import { actionText } from "~/accounts/audit";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { clockTime } from "~/design/times";
import { shortName } from "~/live/urn";
import { mayDo, useSession } from "~/session/session";
import { accessKey, pathOf, SERVICE } from "./health";

const FIRST = 20;
const MOST = 200;

export function AccessCard({ person }: { person: PersonView }) {
  const { t, i18n } = useTranslation(["health", "accounts", "common"]);
  const [count, setCount] = useState(FIRST);
  const { hasAccounts, user } = useSession();
  const own = user?.person ?? null;
  const maySee = mayDo("readAudit") || (own !== null && shortName(own) === person.person);
  const { value, failure } = useServiceQuery<AccessView[]>(SERVICE, maySee ? `${pathOf(person.person)}/accesses?limit=${count}` : null, { keepsPrevious: true });
  const subjects = [...new Set((value ?? []).map(({ subject }) => subject))].sort();
  const asked = new URLSearchParams(subjects.map((subject) => ["subject", subject]));
  const names = useServiceQuery<Record<string, string>>("accounts", hasAccounts && subjects.length > 0 ? `names?${asked.toString()}` : null, { keepsPrevious: true }).value;
  if (!maySee) return null;
  const shown = grouped(value ?? []);
  const who = ({ subject, name, isOwn }: AccessView) => {
    if (subject === "local") return t("access.local");
    if (isOwn) return t("access.you");
    if (names?.[subject] !== undefined) return names[subject];
    return name === null ? t("access.unknown", { id: subject.slice(0, 12) }) : names === null ? name : t("access.deleted", { name });
  };
  return (
    <Card title={t("access.title")} className="health__access">
      <p className="quiet small">{t("access.means")}</p>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {value?.length === 0 && <p className="quiet">{t("access.none")}</p>}
      <ul className="health__list health__accesses">
        {shown.map((each) => {
          const Icon = each.isReading ? Eye : Pencil;
          const key = accessKey(each.action);
          return (
            <li key={each.number} data-reading={each.isReading || undefined}>
              <span className="health__access-what">
                <Icon aria-hidden size={16} />
                <span>
                  <strong>{who(each)}</strong> {key === null ? actionText(t, each.action) : t(`access.what.${key}`)}
                </span>
              </span>
              <time className="quiet small" dateTime={each.at}>{clockTime(each.at, i18n.language)}</time>
            </li>
          );
        })}
      </ul>
      {value !== null && value.length >= count && count < MOST && (
        <Button onPress={() => setCount(Math.min(MOST, count * 4))}>{t("access.more")}</Button>
      )}
    </Card>
  );
}

/** A page reads several histories at once; who did the same within a minute is shown once. */
function grouped(accesses: readonly AccessView[]): AccessView[] {
  const sameOf = ({ subject, action, at }: AccessView) => `${subject} ${accessKey(action) ?? action} ${at.slice(0, "2026-05-04T10:00".length)}`;
  return [...new Map(accesses.map((each) => [sameOf(each), each])).values()];
}
