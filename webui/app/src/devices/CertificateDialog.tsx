/** The certificate of a device and its private key, which can be saved only now. */
import { Download } from "lucide-react";
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { useTranslation } from "react-i18next";
import type { CertificateView } from "~/api/generated/device-gateway";
import { Button } from "~/design/Button";
import "~/design/ConfirmDialog.css";

export function CertificateDialog({ made, onClose }: { made: CertificateView | null; onClose: () => void }) {
  const { t } = useTranslation("devices");
  if (made === null) return null;
  const files = [
    { part: "key", name: `${made.name}.key.pem`, text: made.key },
    { part: "certificate", name: `${made.name}.pem`, text: made.certificate },
    { part: "authority", name: "authority.pem", text: made.authority },
  ];
  return (
    // A press beside the dialog does not lose the key.
    <ModalOverlay isOpen className="confirm-dialog__overlay" isDismissable={false}>
      <Modal className="confirm-dialog">
        <Dialog className="confirm-dialog__dialog">
          <Heading slot="title" className="confirm-dialog__title">
            {t("certificate.title", { name: made.name })}
          </Heading>
          <div className="confirm-dialog__form">
            <p>{t("certificate.once")}</p>
            {files.map(({ part, name, text }) => (
              <a key={part} className="button button--plain button--normal" download={name} href={`data:application/x-pem-file;base64,${btoa(text)}`}>
                <Download aria-hidden size={18} />
                {t(`certificate.${part}`)} ({name})
              </a>
            ))}
            <div className="confirm-dialog__actions">
              <Button kind="main" onPress={onClose}>
                {t("certificate.done")}
              </Button>
            </div>
          </div>
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}
