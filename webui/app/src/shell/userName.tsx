/** The name of the person at this screen: that of the user, or without accounts asked once, stored on this device, recorded with manual actions. */
import { useState, useSyncExternalStore } from "react";
import { useTranslation } from "react-i18next";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Field } from "~/design/Field";
import { currentSession, onSession, useSession } from "~/session/session";

const STORAGE_KEY = "handover.who";
const listeners = new Set<() => void>();

export function userName(): string {
  const { hasAccounts, user } = currentSession();
  return (hasAccounts ? user?.name : localStorage.getItem(STORAGE_KEY)) ?? "";
}

export function setUserName(name: string): void {
  localStorage.setItem(STORAGE_KEY, name.trim().slice(0, 100));
  for (const listener of listeners) listener();
}

export function useUserName(): string {
  return useSyncExternalStore((listener) => {
    listeners.add(listener);
    const forget = onSession(listener); // at a station another person may have joined
    return () => {
      listeners.delete(listener);
      forget();
    };
  }, userName);
}

/** The name to record, where there are no accounts to say it; nothing with accounts, whose name is recorded. */
export function UserNameField({ value, onChange, hint, autoFocus = false }: { value: string; onChange: (name: string) => void; hint: string; autoFocus?: boolean }) {
  const { t } = useTranslation("common");
  if (useSession().hasAccounts) return null;
  return <Field label={t("who.label")} hint={hint} value={value} onChange={onChange} maxLength={100} isRequired validationBehavior="aria" autoFocus={autoFocus} />;
}

/**
* An action that is recorded with a name: `withName(act)` runs `act(name)` at once if the name is known,
* else asks for it first; render `question`, the dialog.
 */
export function useWithName(size: "normal" | "large" = "normal") {
  const { t } = useTranslation("common");
  const [waiting, setWaiting] = useState<((name: string) => Promise<unknown>) | null>(null);
  const [name, setName] = useState("");
  const withName = async (act: (name: string) => Promise<unknown>): Promise<void> => {
    const name = userName();
    if (name !== "") await act(name);
    else setWaiting(() => act);
  };
  const question = (
    <ConfirmDialog
      isOpen={waiting !== null}
      onClose={() => setWaiting(null)}
      title={t("who.ask")}
      act={t("who.save")}
      size={size}
      isDisabled={name.trim() === ""}
      onAct={async () => {
        setUserName(name);
        await waiting?.(userName());
      }}
    >
      <Field label={t("who.label")} hint={t("who.hint")} value={name} onChange={setName} size={size} autoFocus />
    </ConfirmDialog>
  );
  return { withName, question };
}
