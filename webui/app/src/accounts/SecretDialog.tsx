/** A secret that is shown once: a link, a token or a code, with a button that copies it. */
import type { ReactNode } from "react";
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { CopyButton } from "~/design/CopyButton";
import "~/design/ConfirmDialog.css";

export interface Secret {
  title: string;
  means: string;
  value: string;
  /** The secret as a picture, to print. */
  picture?: ReactNode;
}

export function SecretDialog({ secret, onClose }: { secret: Secret | null; onClose: () => void }) {
  const { t } = useTranslation(["accounts", "common"]);
  return (
    <ModalOverlay className="confirm-dialog__overlay" isOpen={secret !== null} onOpenChange={(open) => !open && onClose()}>
      <Modal className="confirm-dialog">
        <Dialog className="confirm-dialog__dialog confirm-dialog__form">
          {secret !== null && (
            <>
              <Heading slot="title" className="confirm-dialog__title">
                {secret.title}
              </Heading>
              <p>{secret.means}</p>
              {secret.picture}
              <div className="field field--code">
                <textarea readOnly rows={3} aria-label={secret.title} value={secret.value} onFocus={(event) => event.target.select()} />
              </div>
              <p className="quiet">{t("secret.shown")}</p>
              <div className="confirm-dialog__actions">
                <Button onPress={onClose}>{t("common:close")}</Button>
                <CopyButton text={secret.value}>{t("secret.copy")}</CopyButton>
              </div>
            </>
          )}
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}
