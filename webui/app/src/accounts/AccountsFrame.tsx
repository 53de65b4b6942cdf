/** What an accounts view needs: accounts at all, and the permission. Without them it says how to get them. */
import { Lock, ShieldCheck } from "lucide-react";
import type { ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { EmptyState } from "~/design/EmptyState";
import { useSession } from "~/session/session";
import { useAdmins } from "~/session/rights";

const SET_UP = "handover accounts set-up";
const SECURE = "handover secure";

export interface AccountsFrameProps {
  /** The permission of the view; null for what everybody may do who is signed in. */
  permission: string | null;
  /** Whether the view works without accounts as well. */
  isLocalToo?: boolean;
  children: ReactNode;
}

export function AccountsFrame({ permission, isLocalToo = false, children }: AccountsFrameProps) {
  const { t } = useTranslation("accounts");
  const { hasAccounts, user } = useSession();
  if (!hasAccounts && !isLocalToo) {
    return (
      <EmptyState icon={<ShieldCheck aria-hidden size={32} />} title={t("local.title")}>
        <p>{t("local.means")}</p>
        <pre className="accounts__command">{SET_UP}</pre>
        <p>{t("local.secure")}</p>
        <pre className="accounts__command">{SECURE}</pre>
      </EmptyState>
    );
  }
  if (permission !== null && user?.permissions.includes(permission) === false) return <Missing permission={permission} />;
  return children;
}

function Missing({ permission }: { permission: string }) {
  const { t } = useTranslation(["accounts", "rights"]);
  const admins = useAdmins();
  return (
    <EmptyState icon={<Lock aria-hidden size={32} />} title={t("missing.title", { permission: t(`rights:permission.${permission}`, { defaultValue: permission }) })}>
      {admins.length === 0 ? t("missing.anyAdmin") : t("missing.admins", { names: admins.join(", ") })}
    </EmptyState>
  );
}
