/** The settings of the station: screen size and viewing distance, stored on this device. */
import { Minus, Plus } from "lucide-react";
import { useState } from "react";
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { Checkbox } from "~/design/Checkbox";
import "~/design/ConfirmDialog.css";
import { number } from "~/design/numbers";
import { setKiosk, useKiosk } from "~/shell/kiosk";
import { useParticipantMode } from "~/study/participantMode";
import { bounds, keepStation, minFontPx, useStation, type Station } from "./station";
import "./StationPanel.css";

export function StationPanel({ onClose }: { onClose: () => void }) {
  const { t, i18n } = useTranslation(["work", "common"]);
  const { station } = useStation();
  const [draft, setDraft] = useState<Station>(station);
  const kiosk = useKiosk();
  const [hidesNavigation, setHidesNavigation] = useState(kiosk);
  const isParticipant = useParticipantMode() !== null;
  const { width, height } = window.screen;
  const formatted = (value: number) => number(value, i18n.language, { maximumFractionDigits: 1 });
  const px = Math.round(minFontPx(draft, { width, height }));
  return (
    <ModalOverlay className="confirm-dialog__overlay" isOpen onOpenChange={(open) => !open && onClose()} isDismissable>
      <Modal className="confirm-dialog confirm-dialog--large">
        <Dialog className="confirm-dialog__dialog confirm-dialog__form">
          <Heading slot="title" className="confirm-dialog__title">
            {t("station.title")}
          </Heading>
          <p>{t("station.means")}</p>
          <Stepper
            label={t("station.diagonal")}
            value={draft.diagonalIn}
            formatted={t("station.inches", { value: formatted(draft.diagonalIn) })}
            {...bounds.diagonalIn}
            onChange={(diagonalIn) => setDraft({ ...draft, diagonalIn })}
          />
          <Stepper
            label={t("station.distance")}
            value={draft.distanceM}
            formatted={t("station.metres", { value: formatted(draft.distanceM) })}
            {...bounds.distanceM}
            onChange={(distanceM) => setDraft({ ...draft, distanceM })}
          />
          <p className="quiet" role="status">
            {t("station.result", { px: formatted(px) })}
          </p>
          {!isParticipant && (
            <div className="station__kiosk">
              <Checkbox size="large" isSelected={hidesNavigation} onChange={setHidesNavigation}>
                {t("kiosk.hide")}
              </Checkbox>
              <p className="quiet">{t("kiosk.means")}</p>
            </div>
          )}
          <div className="confirm-dialog__actions">
            <Button
              size="large"
              onPress={() => {
                keepStation(null);
                onClose();
              }}
            >
              {t("station.standard")}
            </Button>
            <Button
              size="large"
              kind="main"
              onPress={() => {
                keepStation(draft);
                if (!isParticipant) setKiosk(hidesNavigation);
                onClose();
              }}
            >
              {t("station.keep")}
            </Button>
          </div>
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

interface StepperProps {
  label: string;
  value: number;
  formatted: string;
  min: number;
  max: number;
  step: number;
  onChange: (value: number) => void;
}

function Stepper({ label, value, formatted, min, max, step, onChange }: StepperProps) {
  const { t } = useTranslation("work");
  const moved = (by: number) => Math.round(Math.min(max, Math.max(min, value + by)) * 10) / 10;
  return (
    <div className="station__stepper" role="group" aria-label={label}>
      <span>{label}</span>
      <Button size="large" label={t("station.less", { what: label })} icon={<Minus aria-hidden size="1em" />} isDisabled={value <= min} onPress={() => onChange(moved(-step))} />
      <output>{formatted}</output>
      <Button size="large" label={t("station.more", { what: label })} icon={<Plus aria-hidden size="1em" />} isDisabled={value >= max} onPress={() => onChange(moved(step))} />
    </div>
  );
}
