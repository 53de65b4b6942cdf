/** The dead-man control: always in sight while this person controls the robot. */
import { Hand } from "lucide-react";
import { useTranslation } from "react-i18next";
import { HoldButton } from "./HoldButton";
import { keyName } from "./keyName";
import type { Control } from "./useControl";

export function HoldBar({ control: { connection, driver, now } }: { control: Control }) {
  const { t } = useTranslation("control");
  if (now.phase !== "on") return null;
  const state = now.state;
  const why = now.stopped === null ? "" : t(`stopped.${now.stopped}`);
  const text =
    state?.needsRelease === true ? t("hold.release") : state?.limit != null && !state.moves ? t("hold.limit", { limit: state.limit }) : state?.moves === true ? t("hold.moves") : t("hold.hold", { key: keyName(driver.keyboard.keys.hold) });
  return (
    <div className="hold-bar" data-takes-keyboard data-moves={state?.moves === true || undefined}>
      <HoldButton
        className="hold-bar__button"
        onHold={(isHeld) => {
          driver.hold(isHeld);
          connection.send();
        }}
      >
        <Hand aria-hidden size={28} />
        <span>{t("hold.button")}</span>
      </HoldButton>
      <p role="status">
        {why !== "" && <strong>{why} </strong>}
        {text}
      </p>
    </div>
  );
}
