/** Who stands at this screen: asked once, kept on this device, noted with what is done by hand. */
import { useState, useSyncExternalStore } from "react";
import { useTranslation } from "react-i18next";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Field } from "~/design/Field";

const STORAGE_KEY = "handover.who";
const listeners = new Set<() => void>();

export function userName(): string {
  return localStorage.getItem(STORAGE_KEY) ?? "";
}

export function setUserName(name: string): void {
  localStorage.setItem(STORAGE_KEY, name.trim().slice(0, 100));
  for (const listener of listeners) listener();
}

export function useUserName(): string {
  return useSyncExternalStore((listener) => {
    listeners.add(listener);
    return () => listeners.delete(listener);
  }, userName);
}

/**
 * Do something that is noted with a name: `withName(act)` runs `act(name)` at once when the name is known,
 * else asks for it first; `question` is the dialog to put on the page.
 */
export function useWithName(size: "normal" | "large" = "normal") {
  const { t } = useTranslation("common");
  const [waiting, setWaiting] = useState<((name: string) => Promise<unknown>) | null>(null);
  const [name, setName] = useState("");
  const withName = async (act: (name: string) => Promise<unknown>): Promise<void> => {
    const known = userName();
    if (known !== "") await act(known);
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
