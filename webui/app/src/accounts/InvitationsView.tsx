/** Requests for accounts, and the links that nobody has used yet. */
import { UserPlus } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { RelativeTime } from "~/design/RelativeTime";
import { exactTime } from "~/design/times";
import { useKeys } from "~/shell/keys";
import { closeRequest, SERVICE, withdraw, type AccountRequestView, type LinkView } from "./accounts";
import { useGrantWords } from "./GrantList";
import { InviteDialog } from "./Invite";
import { SecretDialog, type Secret } from "./SecretDialog";

const REFRESH_MS = 15_000;

/** The invitation that is being written; with the request that it answers. */
interface Invitation {
  request: AccountRequestView | null;
}

export function InvitationsView() {
  const { t, i18n } = useTranslation("accounts");
  const words = useGrantWords();
  const links = useServiceQuery<LinkView[]>(SERVICE, "invitations", { intervalMs: REFRESH_MS });
  const requests = useServiceQuery<AccountRequestView[]>(SERVICE, "account-requests", { intervalMs: REFRESH_MS });
  const [inviting, setInviting] = useState<Invitation | null>(null);
  const [secret, setSecret] = useState<Secret | null>(null);
  const [refused, setRefused] = useState<string | null>(null);
  useKeys([{ key: "n", does: t("invite.act"), act: () => setInviting({ request: null }) }]);
  const act = async (action: Promise<unknown>) => {
    setRefused(null);
    try {
      await action;
    } catch (error) {
      setRefused(errorText(error));
    }
    links.reload();
    requests.reload();
  };
  const failure = refused ?? links.failure ?? requests.failure;
  return (
    <div className="accounts__narrow">
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <Card title={t("requests.title")}>
        {requests.value?.length === 0 && <p className="quiet">{t("requests.none")}</p>}
        <ul className="accounts__rows">
          {requests.value?.map((request) => (
            <li key={request.id}>
              <div>
                <strong>{request.name}</strong> <span className="quiet"><RelativeTime at={request.createdAt} isStop /></span>
                {request.contact !== "" && <p className="small">{request.contact}</p>}
                {request.note !== "" && <p className="quiet small">{request.note}</p>}
              </div>
              <span className="accounts__acts">
                <Button kind="main" onPress={() => setInviting({ request })}>
                  {t("requests.grant")}
                </Button>
                <Button label={t("requests.refuseOne", { name: request.name })} onPress={() => void act(closeRequest(request.id))}>
                  {t("requests.refuse")}
                </Button>
              </span>
            </li>
          ))}
        </ul>
      </Card>
      <Card
        title={t("links.title")}
        aside={
          <Button kind="main" icon={<UserPlus aria-hidden size={18} />} onPress={() => setInviting({ request: null })}>
            {t("invite.act")}
          </Button>
        }
      >
        {links.value?.length === 0 && <p className="quiet">{t("links.none")}</p>}
        <ul className="accounts__rows">
          {links.value?.map((link) => (
            <li key={link.id}>
              <div>
                <strong>{link.name ?? t("links.anybody")}</strong> <span className="quiet">{t(`links.purpose.${link.purpose}`, { defaultValue: link.purpose })}</span>
                {link.grants.length > 0 && <p className="small">{words(link.grants)}</p>}
                <p className="quiet small">
                  {t("links.made")} <RelativeTime at={link.createdAt} isStop /> · {t("links.until", { until: exactTime(link.expiresAt, i18n.language) })}
                </p>
              </div>
              <Button label={t("links.withdrawOne", { name: link.name ?? t("links.anybody") })} onPress={() => void act(withdraw(link.id))}>
                {t("links.withdraw")}
              </Button>
            </li>
          ))}
        </ul>
      </Card>
      {inviting !== null && (
        <InviteDialog
          isOpen
          name={inviting.request?.name ?? ""}
          onClose={() => {
            setInviting(null);
            links.reload();
            requests.reload();
          }}
          onLink={setSecret}
          {...(inviting.request === null ? {} : { onInvited: () => closeRequest(inviting.request?.id ?? "") })}
        />
      )}
      <SecretDialog secret={secret} onClose={() => setSecret(null)} />
    </div>
  );
}
