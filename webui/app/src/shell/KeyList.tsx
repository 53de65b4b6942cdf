/** All keys, those of the page first. */
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import "~/design/ConfirmDialog.css";
import "./KeyList.css";

interface Row {
  key: string;
  does: string;
}

export function KeyList({ isOpen, onClose, everywhere, here }: { isOpen: boolean; onClose: () => void; everywhere: readonly Row[]; here: readonly Row[] }) {
  const { t } = useTranslation("common");
  return (
    <ModalOverlay className="confirm-dialog__overlay" isOpen={isOpen} onOpenChange={(open) => !open && onClose()} isDismissable>
      <Modal className="confirm-dialog">
        <Dialog className="confirm-dialog__dialog key-list">
          <Heading slot="title" className="confirm-dialog__title">
            {t("keys.title")}
          </Heading>
          <h3>{t("keys.here")}</h3>
          {here.length === 0 ? <p className="quiet">{t("keys.none")}</p> : <Rows rows={here} />}
          <h3>{t("keys.everywhere")}</h3>
          <Rows rows={everywhere} />
          <div className="confirm-dialog__actions">
            <Button onPress={onClose}>{t("close")}</Button>
          </div>
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

const signs: Record<string, string> = { " ": "␣", ArrowUp: "↑", ArrowDown: "↓", ArrowLeft: "←", ArrowRight: "→" };

function Rows({ rows }: { rows: readonly Row[] }) {
  return (
    <dl className="key-list__rows">
      {rows.map((row) => (
        <div key={row.key}>
          <dt>
            <kbd>{signs[row.key] ?? row.key}</kbd>
          </dt>
          <dd>{row.does}</dd>
        </div>
      ))}
    </dl>
  );
}
