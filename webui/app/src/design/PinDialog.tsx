/** Asks for the PIN that an act demands. */
import { useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { ConfirmDialog } from "./ConfirmDialog";
import { MIN_PIN_DIGITS, PinPad } from "./PinPad";

export interface PinDialogProps {
  /** What is asked, and the act; without them, those of a Task. */
  title?: string;
  act?: string;
  onClose: () => void;
  /** Use the PIN; an error is shown, and another PIN can be entered. */
  onPin: (pin: string) => Promise<unknown>;
  children?: ReactNode;
}

export function PinDialog({ title, act, onClose, onPin, children }: PinDialogProps) {
  const { t } = useTranslation("common");
  const [pin, setPin] = useState("");
  const give = () =>
    onPin(pin).catch((error: unknown) => {
      setPin("");
      throw error;
    });
  return (
    <ConfirmDialog isOpen onClose={onClose} title={title ?? t("pin.title")} act={act ?? t("pin.give")} size="large" isDisabled={pin.length < MIN_PIN_DIGITS} onAct={give}>
      {children}
      <PinPad label={t("pin.label")} value={pin} onChange={setPin} autoFocus />
    </ConfirmDialog>
  );
}
