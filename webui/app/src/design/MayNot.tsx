/** Says which permission an action needs that the user does not have, and who can grant it; nothing to those who have it. */
import { useTranslation } from "react-i18next";
import { missingRight, useAdmins } from "~/session/rights";
import { mayDo, rolesWith, useSession, type Permission } from "~/session/session";

interface MayNotProps {
  permission: Permission;
  className?: string;
}

export function MayNot(props: MayNotProps) {
  useSession();
  return mayDo(props.permission) ? null : <Missing {...props} />;
}

function Missing({ permission, className = "quiet" }: MayNotProps) {
  useTranslation(["rights", "roles"]);
  useAdmins();
  return <p className={className}>{missingRight({ permission, roles: rolesWith(permission) })}</p>;
}
