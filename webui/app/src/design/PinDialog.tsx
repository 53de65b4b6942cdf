/** Asks for the PIN that a Task demands. */
import { useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { ConfirmDialog } from "./ConfirmDialog";
import { MIN_PIN_DIGITS, PinPad } from "./PinPad";

export interface PinDialogProps {
  onClose: () => void;
  /** Use the PIN; an error is shown, and another PIN can be entered. */
  onPin: (pin: string) => Promise<unknown>;
  children?: ReactNode;
}

export function PinDialog({ onClose, onPin, children }: PinDialogProps) {
  const { t } = useTranslation("common");
  const [pin, setPin] = useState("");
  const give = () =>
    onPin(pin).catch((error: unknown) => {
      setPin("");
      throw error;
    });
  return (
    <ConfirmDialog isOpen onClose={onClose} title={t("pin.title")} act={t("pin.give")} size="large" isDisabled={pin.length < MIN_PIN_DIGITS} onAct={give}>
      {children}
      <PinPad label={t("pin.label")} value={pin} onChange={setPin} autoFocus />
    </ConfirmDialog>
  );
}
