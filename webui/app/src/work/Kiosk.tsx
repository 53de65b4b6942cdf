/** The way out of the kiosk: hold the upper left corner, or press Escape; a station asks for a PIN. */
import { useEffect, useRef, useState } from "react";
import { useTranslation } from "react-i18next";
import { requestService } from "~/api/http";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { PinDialog } from "~/design/PinDialog";
import { loadSession, useSession } from "~/session/session";
import { setKiosk } from "~/shell/kiosk";

export const CORNER_HOLD_MS = 2000;

export function KioskExit() {
  const { t } = useTranslation("work");
  const isStation = useSession().user?.isStation === true;
  const [asks, setAsks] = useState(false);
  const timer = useRef<ReturnType<typeof setTimeout> | undefined>(undefined);
  useEffect(() => {
    const onKey = (event: KeyboardEvent) => {
      const isForDialog = document.querySelector("[role=dialog], [role=alertdialog]") !== null;
      if (event.key === "Escape" && !event.defaultPrevented && !isForDialog) setAsks(true);
    };
    addEventListener("keydown", onKey);
    return () => {
      clearTimeout(timer.current);
      removeEventListener("keydown", onKey);
    };
  }, []);
  const release = () => clearTimeout(timer.current);
  return (
    <>
      <div
        className="work__corner"
        aria-hidden
        onPointerDown={(event) => {
          event.currentTarget.setPointerCapture(event.pointerId);
          timer.current = setTimeout(() => (isStation ? setAsks(true) : setKiosk(false)), CORNER_HOLD_MS);
        }}
        onPointerUp={release}
        onPointerCancel={release}
        onLostPointerCapture={release}
        onContextMenu={(event) => event.preventDefault()}
      />
      {asks && isStation && (
        <PinDialog title={t("kiosk.leave")} act={t("kiosk.leaveAct")} onClose={() => setAsks(false)} onPin={joinAndLeave}>
          <p>{t("kiosk.pin")}</p>
        </PinDialog>
      )}
      {asks && !isStation && (
        <ConfirmDialog
          isOpen
          onClose={() => setAsks(false)}
          title={t("kiosk.leave")}
          act={t("kiosk.leaveAct")}
          size="large"
          onAct={() => {
            setKiosk(false);
            return Promise.resolve();
          }}
        >
          <p>{t("kiosk.leaveMeans")}</p>
        </ConfirmDialog>
      )}
    </>
  );
}

/** A person who shows the navigation of a station has joined it, so that the station knows who acts. */
async function joinAndLeave(pin: string): Promise<void> {
  await requestService("accounts", "me/station/person", { method: "PUT", json: { method: "pin", value: pin } });
  await loadSession();
  setKiosk(false);
}
