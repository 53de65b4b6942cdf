/** The dialog that invites a person: a name, a first grant, and then the link. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Field } from "~/design/Field";
import { addressOf, invite, type NewLink } from "./accounts";
import { GrantForm } from "./GrantForm";
import { grantsOf, NEW_DRAFT } from "./grants";
import type { Secret } from "./SecretDialog";

export interface InviteDialogProps {
  isOpen: boolean;
  /** The name that a request for an account gives. */
  name?: string;
  onClose: () => void;
  onLink: (secret: Secret) => void;
  onInvited?: () => Promise<unknown>;
}

/** The text of a new link, for the dialog that shows it once. */
export function useLinkSecret(): (link: NewLink, kind: "invitation" | "password") => Secret {
  const { t, i18n } = useTranslation("accounts");
  return (link, kind) => ({
    title: t(`link.${kind}`),
    means: t("link.means", { until: new Date(link.expiresAt).toLocaleString(i18n.language, { dateStyle: "medium", timeStyle: "short" }) }),
    value: addressOf(link),
  });
}

export function InviteDialog({ isOpen, name: asked = "", onClose, onLink, onInvited }: InviteDialogProps) {
  const { t } = useTranslation("accounts");
  const secretOf = useLinkSecret();
  const [name, setName] = useState(asked);
  const [draft, setDraft] = useState(NEW_DRAFT);
  const grants = grantsOf(draft);
  return (
    <ConfirmDialog
      isOpen={isOpen}
      onClose={onClose}
      title={t("invite.title")}
      act={t("invite.act")}
      isDisabled={grants.length === 0}
      onAct={async () => {
        const link = await invite({ grants, ...(name.trim() === "" ? {} : { name: name.trim() }) });
        await onInvited?.();
        onLink(secretOf(link, "invitation"));
      }}
    >
      <Field label={t("invite.name")} hint={t("invite.nameHint")} value={name} onChange={setName} maxLength={64} autoFocus />
      <GrantForm draft={draft} onChange={setDraft} />
    </ConfirmDialog>
  );
}
