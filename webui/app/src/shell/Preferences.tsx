/** How the screen looks and speaks, and whose name it notes; kept on this device. */
import { useState } from "react";
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { Choice } from "~/design/Choice";
import { Field } from "~/design/Field";
import { languages, speak, type Language } from "~/i18n";
import { setSound, useSound } from "~/alerts/sound";
import { Tick } from "~/design/Tick";
import { chooseTheme, chosenTheme, type Theme } from "./theme";
import { setWho, useWho } from "./who";
import "~/design/Ask.css";

export function Preferences({ isOpen, onClose }: { isOpen: boolean; onClose: () => void }) {
  const { t, i18n } = useTranslation("common");
  const [theme, setTheme] = useState<Theme>(chosenTheme);
  const name = useWho();
  const sound = useSound();
  const themes = (["system", "light", "dark"] as const).map((value) => ({ value, name: t(`theme.${value}`) }));
  const tongues = Object.entries(languages).map(([value, tongue]) => ({ value: value as Language, name: tongue }));
  return (
    <ModalOverlay className="ask__veil" isOpen={isOpen} onOpenChange={(open) => !open && onClose()} isDismissable>
      <Modal className="ask">
        <Dialog className="ask__dialog ask__form">
          <Heading slot="title" className="ask__title">
            {t("settings")}
          </Heading>
          <div>
            <h3>{t("theme.label")}</h3>
            <Choice
              label={t("theme.label")}
              value={theme}
              options={themes}
              onChange={(chosen) => {
                setTheme(chosen);
                chooseTheme(chosen);
              }}
            />
          </div>
          <div>
            <h3>{t("language")}</h3>
            <Choice
              label={t("language")}
              value={i18n.language as Language}
              options={tongues}
              onChange={(tongue) => void speak(tongue)}
            />
          </div>
          <Tick isSelected={sound} onChange={setSound}>
            {t("attention.sound")}
          </Tick>
          <Field label={t("who.label")} hint={t("who.hint")} value={name} onChange={setWho} maxLength={100} />
          <div className="ask__acts">
            <Button kind="main" onPress={onClose}>
              {t("close")}
            </Button>
          </div>
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}
