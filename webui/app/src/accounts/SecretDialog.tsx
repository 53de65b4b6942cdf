/** A secret that is shown once: a link or a token, with a button that copies it. */
import { Check, Copy } from "lucide-react";
import { useRef, useState } from "react";
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import "~/design/ConfirmDialog.css";

export interface Secret {
  title: string;
  means: string;
  value: string;
}

export function SecretDialog({ secret, onClose }: { secret: Secret | null; onClose: () => void }) {
  return (
    <ModalOverlay className="confirm-dialog__overlay" isOpen={secret !== null} onOpenChange={(open) => !open && onClose()}>
      <Modal className="confirm-dialog">
        <Dialog className="confirm-dialog__dialog confirm-dialog__form">{secret !== null && <Content secret={secret} onClose={onClose} />}</Dialog>
      </Modal>
    </ModalOverlay>
  );
}

function Content({ secret, onClose }: { secret: Secret; onClose: () => void }) {
  const { t } = useTranslation(["accounts", "common"]);
  const text = useRef<HTMLTextAreaElement>(null);
  const [state, setState] = useState<"shown" | "copied" | "refused">("shown");
  const copy = async () => {
    text.current?.select();
    try {
      await navigator.clipboard.writeText(secret.value);
      setState("copied");
    } catch {
      setState("refused"); // without TLS a browser offers no clipboard; the text is selected
    }
  };
  return (
    <>
      <Heading slot="title" className="confirm-dialog__title">
        {secret.title}
      </Heading>
      <p>{secret.means}</p>
      <div className="field field--code">
        <textarea ref={text} readOnly rows={3} aria-label={secret.title} value={secret.value} onFocus={(event) => event.target.select()} />
      </div>
      <p className="quiet" role="status">
        {t(`secret.${state}`)}
      </p>
      <div className="confirm-dialog__actions">
        <Button onPress={onClose}>{t("common:close")}</Button>
        <Button kind="main" icon={state === "copied" ? <Check aria-hidden size={18} /> : <Copy aria-hidden size={18} />} onPress={() => void copy()}>
          {t("secret.copy")}
        </Button>
      </div>
    </>
  );
}
