/** All keys that have an effect now, those of the page first. */
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { SHORTCUT } from "~/palette/shortcut";
import { hasLead, LEAD, useKeysOn } from "./keys";
import "~/design/ConfirmDialog.css";
import "./KeyList.css";

interface Row {
  key: string;
  does: string;
}

interface KeyListProps {
  isOpen: boolean;
  onClose: () => void;
  /** Bring the guide of the first steps back. */
  onGuide: () => void;
  everywhere: readonly Row[];
  here: readonly Row[];
}

export function KeyList({ isOpen, onClose, onGuide, everywhere, here }: KeyListProps) {
  const { t } = useTranslation("common");
  const isOn = useKeysOn();
  const inEffect = (rows: readonly Row[]) => rows.filter((row) => isOn || !hasLead(row));
  return (
    <ModalOverlay className="confirm-dialog__overlay" isOpen={isOpen} onOpenChange={(open) => !open && onClose()} isDismissable>
      <Modal className="confirm-dialog">
        <Dialog className="confirm-dialog__dialog key-list">
          <Heading slot="title" className="confirm-dialog__title">
            {t("keys.title")}
          </Heading>
          <p className="quiet">{t(isOn ? "keys.means" : "keys.off")}</p>
          <h3>{t("keys.here")}</h3>
          {inEffect(here).length === 0 ? <p className="quiet">{t("keys.none")}</p> : <Rows rows={inEffect(here)} />}
          <h3>{t("keys.everywhere")}</h3>
          <Rows rows={[{ key: SHORTCUT, does: t("palette") }, ...inEffect(everywhere), { key: "Enter", does: t("keys.press") }]} />
          <div className="confirm-dialog__actions">
            <Button onPress={onGuide}>{t("keys.guide")}</Button>
            <Button onPress={onClose}>{t("close")}</Button>
          </div>
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

/** The keys of a row: with the stroke before the letter, or those that are pressed together. */
function strokes(row: Row): string[] {
  return hasLead(row) ? [LEAD, row.key] : row.key.split(" ");
}

function Rows({ rows }: { rows: readonly Row[] }) {
  return (
    <dl className="key-list__rows">
      {rows.map((row) => (
        <div key={row.key}>
          <dt>
            {strokes(row).map((stroke) => (
              <kbd key={stroke}>{stroke}</kbd>
            ))}
          </dt>
          <dd>{row.does}</dd>
        </div>
      ))}
    </dl>
  );
}
