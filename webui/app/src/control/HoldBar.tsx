/** The dead-man control: always in sight, a part of the page that covers nothing. */
import { Hand } from "lucide-react";
import { useTranslation } from "react-i18next";
import { HoldButton } from "./HoldButton";
import { keyName } from "./keyName";
import type { Control } from "./useControl";

export function HoldBar({ control: { connection, driver, now }, isOld }: { control: Control; isOld: boolean }) {
  const { t } = useTranslation("control");
  const isOn = now.phase === "on";
  const state = now.state;
  const why = now.stopped === null ? "" : t(`stopped.${now.stopped}`);
  return (
    <div className="hold-bar" data-takes-keyboard={isOn || undefined} data-moves={(isOn && state?.moves === true) || undefined}>
      <HoldButton
        className="hold-bar__button"
        isDisabled={!isOn}
        onHold={(isHeld) => {
          driver.hold(isHeld);
          connection.send();
        }}
      >
        <Hand aria-hidden size={28} />
        <span>{t("hold.button")}</span>
      </HoldButton>
      <p role="status">
        {isOn && !isOld && why !== "" && <strong>{why} </strong>}
        {text()}
      </p>
    </div>
  );

  function text(): string {
    if (isOld) return t("hold.old");
    if (!isOn) return t("hold.off");
    if (state?.needsRelease === true) return t("hold.release");
    if (state?.limit != null && !state.moves) return t("hold.limit", { limit: state.limit });
    return state?.moves === true ? t("hold.moves") : t("hold.hold", { key: keyName(driver.keyboard.keys.hold) });
  }
}
