/** Sessions with their devices and places; each can be ended. */
import { LogOut } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { deviceName, endSession, endSessions, SERVICE, type SessionView } from "./accounts";

const REFRESH_MS = 15_000;

export interface SessionsProps {
  /** The route of the sessions: `me/sessions`, or that of a user. */
  path: string;
  endAll: string;
  onEnded?: () => void;
}

export function Sessions({ path, endAll, onEnded }: SessionsProps) {
  const { t } = useTranslation("accounts");
  const { value, failure, reload } = useServiceQuery<SessionView[]>(SERVICE, path, { intervalMs: REFRESH_MS });
  const [refused, setRefused] = useState<string | null>(null);
  const act = async (action: Promise<unknown>) => {
    setRefused(null);
    try {
      await action;
    } catch (error) {
      setRefused(errorText(error));
    }
    reload();
    onEnded?.();
  };
  const open = value ?? [];
  const fault = refused ?? failure;
  return (
    <Card
      title={t("sessions.title")}
      aside={
        open.some(({ isThis }) => !isThis) && (
          <Button kind="quiet" icon={<LogOut aria-hidden size={18} />} onPress={() => void act(endSessions(path))}>
            {endAll}
          </Button>
        )
      }
    >
      {fault !== null && <ErrorMessage>{fault}</ErrorMessage>}
      {value?.length === 0 && <p className="quiet">{t("sessions.none")}</p>}
      <ul className="accounts__rows">
        {open.map((session) => (
          <li key={session.id}>
            <div>
              <strong title={session.device}>{deviceName(session.device) || t("sessions.unknownDevice")}</strong>{" "}
              {session.isThis && <StatusBadge tone="accent">{t("sessions.this")}</StatusBadge>}
              <p className="quiet small">
                {t("sessions.from", { address: session.address || "–", method: t(`method.${session.method}`, { defaultValue: session.method }) })}
              </p>
              <p className="quiet small">
                {t("sessions.signedIn")} <RelativeTime at={session.createdAt} isStop /> · {t("sessions.used")} <RelativeTime at={session.seenAt} isStop />
              </p>
            </div>
            {!session.isThis && (
              <Button
                label={t("sessions.endOne", { device: deviceName(session.device) || t("sessions.unknownDevice"), address: session.address })}
                onPress={() => void act(endSession(path, session.id))}
              >
                {t("sessions.end")}
              </Button>
            )}
          </li>
        ))}
      </ul>
    </Card>
  );
}

/** The sessions of the user who is signed in. */
export function OwnSessionsView() {
  const { t } = useTranslation("accounts");
  return (
    <div className="accounts__narrow">
      <p className="quiet">{t("sessions.ownMeans")}</p>
      <Sessions path="me/sessions" endAll={t("sessions.endOthers")} />
    </div>
  );
}
