/** Theme, language and user name, stored on this device. */
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { SegmentedControl } from "~/design/SegmentedControl";
import { Field } from "~/design/Field";
import { languages, setLanguage, type Language } from "~/i18n";
import { setSound, useSound } from "~/alerts/sound";
import { Checkbox } from "~/design/Checkbox";
import { setKeysOn, useKeysOn } from "./keys";
import { storeTheme, useStoredTheme } from "./theme";
import { setUserName, useUserName } from "./userName";
import "~/design/ConfirmDialog.css";

export function Preferences({ isOpen, onClose }: { isOpen: boolean; onClose: () => void }) {
  const { t, i18n } = useTranslation("common");
  const theme = useStoredTheme();
  const name = useUserName();
  const sound = useSound();
  const keys = useKeysOn();
  const themes = (["system", "light", "dark"] as const).map((value) => ({ value, name: t(`theme.${value}`) }));
  const languageOptions = Object.entries(languages).map(([value, language]) => ({ value: value as Language, name: language }));
  return (
    <ModalOverlay className="confirm-dialog__overlay" isOpen={isOpen} onOpenChange={(open) => !open && onClose()} isDismissable>
      <Modal className="confirm-dialog">
        <Dialog className="confirm-dialog__dialog confirm-dialog__form">
          <Heading slot="title" className="confirm-dialog__title">
            {t("settings")}
          </Heading>
          <div>
            <h3>{t("theme.label")}</h3>
            <SegmentedControl
              label={t("theme.label")}
              value={theme}
              options={themes}
              onChange={storeTheme}
            />
          </div>
          <div>
            <h3>{t("language")}</h3>
            <SegmentedControl
              label={t("language")}
              value={i18n.language as Language}
              options={languageOptions}
              onChange={(language) => void setLanguage(language)}
            />
          </div>
          <Checkbox isSelected={sound} onChange={setSound}>
            {t("attention.sound")}
          </Checkbox>
          <Checkbox isSelected={keys} onChange={setKeysOn}>
            {t("keys.switch")}
          </Checkbox>
          <Field label={t("who.label")} hint={t("who.hint")} value={name} onChange={setUserName} maxLength={100} />
          <div className="confirm-dialog__actions">
            <Button kind="main" onPress={onClose}>
              {t("close")}
            </Button>
          </div>
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}
