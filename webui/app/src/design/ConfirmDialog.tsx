/** A dialog that confirms an action which cannot be undone; its button names the action. */
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { errorText } from "~/api/http";
import { Button } from "./Button";
import { ErrorMessage } from "./ErrorMessage";
import "./ConfirmDialog.css";

export interface ConfirmDialogProps {
  isOpen: boolean;
  onClose: () => void;
  title: string;
  children?: ReactNode;
  /** The text of the button that confirms: "Cancel bin picking". */
  act: string;
  /** The text of the button that closes the dialog, if "Cancel" would be ambiguous. */
  dismiss?: string;
  kind?: "main" | "stop";
  size?: "normal" | "large";
  isDisabled?: boolean;
  /** Perform the action; an error is shown and the dialog stays open. */
  onAct: () => Promise<unknown>;
}

export function ConfirmDialog({ isOpen, onClose, title, children, act, dismiss, kind = "main", size = "normal", isDisabled = false, onAct }: ConfirmDialogProps) {
  const { t } = useTranslation("common");
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const close = () => {
    setFailure(null);
    onClose();
  };
  const perform = async () => {
    setBusy(true);
    setFailure(null);
    try {
      await onAct();
      close();
    } catch (error) {
      setFailure(errorText(error));
    } finally {
      setBusy(false);
    }
  };
  return (
    <ModalOverlay className="confirm-dialog__overlay" isOpen={isOpen} onOpenChange={(open) => !open && close()} isDismissable>
      <Modal className={`confirm-dialog confirm-dialog--${size}`}>
        <Dialog className="confirm-dialog__dialog">
          <Heading slot="title" className="confirm-dialog__title">
            {title}
          </Heading>
          <form
            className="confirm-dialog__form"
            onSubmit={(event) => {
              event.preventDefault();
              if (!busy && !isDisabled) void perform();
            }}
          >
            {children}
            {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
            <div className="confirm-dialog__actions">
              <Button onPress={close} size={size}>
                {dismiss ?? t("leaveIt")}
              </Button>
              <Button type="submit" kind={kind} size={size} isDisabled={busy || isDisabled}>
                {act}
              </Button>
            </div>
          </form>
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}
