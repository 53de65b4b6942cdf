/** Grants in words: "Engineer: ur10-1, nao-1". */
import { Trash2 } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { byRole, EVERYTHING, resourceName, type GrantView } from "./accounts";

/** "Engineer (ur10-1, nao-1), Viewer" in one line. */
export function useGrantWords(): (grants: readonly { role: string; resource: string }[]) => string {
  const { t } = useTranslation(["accounts", "roles"]);
  return (grants) =>
    byRole(grants)
      .map(({ role, grants: of }) => {
        const name = t(`roles:name.${role}`, { defaultValue: role });
        return of.some(({ resource }) => resource === EVERYTHING) ? name : `${name} (${of.map(({ resource }) => resourceName(resource)).join(", ")})`;
      })
      .join(", ") || t("grants.none");
}

export function GrantList({ grants, onRemove }: { grants: readonly GrantView[]; onRemove: (grant: GrantView) => void }) {
  const { t } = useTranslation(["accounts", "roles"]);
  if (grants.length === 0) return <p className="quiet">{t("grants.noneMeans")}</p>;
  return (
    <ul className="accounts__grants">
      {byRole(grants).map(({ role, grants: of }) => (
        <li key={role}>
          <strong>{t(`roles:name.${role}`, { defaultValue: role })}</strong>
          <p className="quiet small">{t(`roles:may.${role}`, { defaultValue: "" })}</p>
          <ul className="accounts__chips">
            {of.map((grant) => {
              const resource = grant.resource === EVERYTHING ? t("grants.everything") : resourceName(grant.resource);
              return (
                <li key={grant.id} className="accounts__chip" title={grant.resource}>
                  <span>{resource}</span>
                  <Button
                    kind="quiet"
                    label={t("grants.remove", { role: t(`roles:name.${role}`, { defaultValue: role }), resource })}
                    icon={<Trash2 aria-hidden size={16} />}
                    onPress={() => onRemove(grant)}
                  />
                </li>
              );
            })}
          </ul>
        </li>
      ))}
    </ul>
  );
}
