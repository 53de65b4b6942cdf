/** For owners: who asks for an account, who was invited, who joined last, and what is not secure. */
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { useUsers } from "~/accounts/accounts";
import type { AccountRequestView, LinkView } from "~/api/generated/accounts";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Loading } from "~/design/Loading";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { addresses } from "~/places/addresses";
import { More } from "./Section";

const POLL_INTERVAL_MS = 15_000;
const MAX_JOINED = 4;
const MAX_REQUESTS = 4;

export function PeopleSection() {
  const { t } = useTranslation("home");
  const { users, failure } = useUsers();
  const requests = useServiceQuery<AccountRequestView[]>("accounts", "account-requests", { intervalMs: POLL_INTERVAL_MS }).value ?? [];
  const invited = useServiceQuery<LinkView[]>("accounts", "invitations", { intervalMs: POLL_INTERVAL_MS }).value ?? [];
  const joined = [...(users ?? [])].sort((a, b) => (a.createdAt > b.createdAt ? -1 : 1));
  const invitations = addresses.people({ view: "invitations" });
  return (
    <Card className="home__section" title={t("people.title")} aside={users !== null && <span className="home__count">{users.length}</span>}>
      {failure !== null ? <ErrorMessage>{failure}</ErrorMessage> : users === null && <Loading />}
      <ul className="home__list">
        {isUnencrypted() && (
          <li>
            <span>{t("people.unencrypted")}</span>
            <StatusBadge tone="stop">{t("people.notSecure")}</StatusBadge>
            <span className="home__why quiet small">{t("people.encrypt")}</span>
          </li>
        )}
        {requests.slice(0, MAX_REQUESTS).map((request) => (
          <li key={request.id}>
            <Link href={invitations}>{request.name}</Link>
            <StatusBadge tone="attention">{t("people.asks")}</StatusBadge>
            <span className="quiet small">
              <RelativeTime at={request.createdAt} />
            </span>
          </li>
        ))}
        {invited.length > 0 && (
          <li>
            <Link href={invitations}>{t("people.invited", { count: invited.length })}</Link>
          </li>
        )}
        {joined.slice(0, MAX_JOINED).map((user) => (
          <li key={user.subject}>
            <Link href={addresses.people({ view: "users" })}>{user.name}</Link>
            <span className="quiet small">
              {t("people.joined")} <RelativeTime at={user.createdAt} />
            </span>
          </li>
        ))}
      </ul>
      <More count={joined.length - MAX_JOINED} href={addresses.people({ view: "users" })} />
    </Card>
  );
}

/** Names and passwords travel in the open: the page came without TLS from another machine. */
function isUnencrypted(): boolean {
  return location.protocol === "http:" && !/^(localhost|127\.\d+\.\d+\.\d+|\[::1\])$/.test(location.hostname);
}
