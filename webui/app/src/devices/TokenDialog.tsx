/** The token of a device, shown only once, and the line that starts its client. */
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { useTranslation } from "react-i18next";
import type { TokenView } from "~/api/generated/device-gateway";
import { Button } from "~/design/Button";
import { CopyButton } from "~/design/CopyButton";
import "~/design/ConfirmDialog.css";

export function TokenDialog({ made, onClose }: { made: TokenView | null; onClose: () => void }) {
  const { t } = useTranslation("devices");
  if (made === null) return null;
  const line = startLine(made, location.hostname);
  return (
    // A press beside the dialog does not lose the token.
    <ModalOverlay isOpen className="confirm-dialog__overlay" isDismissable={false}>
      <Modal className="confirm-dialog">
        <Dialog className="confirm-dialog__dialog">
          <Heading slot="title" className="confirm-dialog__title">
            {t("token.title", { name: made.name })}
          </Heading>
          <div className="confirm-dialog__form">
            <p>{t("token.once")}</p>
            <Secret label={t("token.token")} text={made.token} copy={t("token.copy")} />
            <p>{t("token.how")}</p>
            <Secret label={t("token.line")} text={line} copy={t("token.copyLine")} />
            <div className="confirm-dialog__actions">
              <Button kind="main" onPress={onClose}>
                {t("token.done")}
              </Button>
            </div>
          </div>
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

function Secret({ label, text, copy }: { label: string; text: string; copy: string }) {
  return (
    <div className="device-secret">
      <code role="textbox" aria-readonly="true" aria-label={label} tabIndex={0}>
        {text}
      </code>
      <CopyButton text={text}>{copy}</CopyButton>
    </div>
  );
}

/** The command that starts the client of a device at `host`, the address of this page. */
export function startLine({ name, token, port, tls }: TokenView, host: string): string {
  return `HANDOVER_DEVICE_TOKEN=${token} python3 device_client.py --host ${host} --port ${port} --device ${name}${tls ? " --tls" : ""}`;
}
