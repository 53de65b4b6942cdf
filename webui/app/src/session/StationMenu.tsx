/** The screen of a station: who has joined it. A person joins by badge, QR code or PIN, and leaves. */
import { LogOut, UserRoundCheck, UserRoundPlus } from "lucide-react";
import { useEffect, useState } from "react";
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { useTranslation } from "react-i18next";
import type { StationView } from "~/api/generated/accounts";
import { errorText, requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { PinDialog } from "~/design/PinDialog";
import { MIN_PIN_DIGITS, PinPad } from "~/design/PinPad";
import { RelativeTime } from "~/design/RelativeTime";
import { methodOf } from "./identification";
import { useOwnStation } from "./ownStation";
import { loadSession } from "./session";
import "~/design/ConfirmDialog.css";
import "./StationMenu.css";

/** A touched screen says so that often, so that the person does not leave by time. */
const SEEN_MS = 30_000;

export function StationMenu({ onSignOut }: { onSignOut: (pin: string) => Promise<void> }) {
  const { t } = useTranslation("common");
  const { station, reload } = useOwnStation();
  const [isOpen, setOpen] = useState(false);
  const joined = station?.joined ?? null;
  useSeen(joined !== null);
  const subject = joined?.subject ?? "";
  useEffect(() => {
    void loadSession(); // the screen acts in the name of the person who has joined
  }, [subject]);
  if (station === null) return null;
  return (
    <>
      <Button
        kind={joined === null ? "main" : "plain"}
        label={joined === null ? t("station.join") : t("station.joined", { name: joined.name, station: station.name })}
        icon={joined === null ? <UserRoundPlus aria-hidden size={20} /> : <UserRoundCheck aria-hidden size={20} />}
        onPress={() => setOpen(true)}
      >
        {joined === null ? t("station.join") : joined.name}
      </Button>
      <ModalOverlay className="confirm-dialog__overlay" isOpen={isOpen} onOpenChange={setOpen} isDismissable>
        <Modal className="confirm-dialog confirm-dialog--large">
          <Dialog className="confirm-dialog__dialog">
            <Heading slot="title" className="confirm-dialog__title">
              {station.name}
            </Heading>
            <Content station={station} onChange={reload} onClose={() => setOpen(false)} onSignOut={onSignOut} />
          </Dialog>
        </Modal>
      </ModalOverlay>
    </>
  );
}

interface ContentProps {
  station: StationView;
  onChange: () => void;
  onClose: () => void;
  onSignOut: (pin: string) => Promise<void>;
}

function Content({ station, onChange, onClose, onSignOut }: ContentProps) {
  const { t } = useTranslation("common");
  const [code, setCode] = useState("");
  const [pin, setPin] = useState("");
  const [busy, setBusy] = useState(false);
  const [isSigningOut, setSigningOut] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const perform = (act: () => Promise<unknown>) => {
    setBusy(true);
    setFailure(null);
    void act()
      .then(async () => {
        await loadSession();
        onChange();
        onClose();
      })
      .catch((error: unknown) => setFailure(errorText(error)))
      .finally(() => {
        setCode("");
        setPin("");
        setBusy(false);
      });
  };
  const join = (method: string, value: string) => perform(() => requestService("accounts", "me/station/person", { method: "PUT", json: { method, value } }));
  const { joined } = station;
  return (
    <div className="station-menu">
      {joined !== null && (
        <div className="station-menu__joined">
          <p role="status">
            <strong>{joined.name}</strong>
            <span className="quiet">
              {t("station.by", { method: t(`station.methods.${joined.method}`, { defaultValue: joined.method }) })} · <RelativeTime at={joined.since} />
            </span>
          </p>
          <Button size="large" icon={<LogOut aria-hidden size="1em" />} isDisabled={busy} onPress={() => perform(() => requestService("accounts", "me/station/person", { method: "DELETE" }))}>
            {t("station.leave")}
          </Button>
        </div>
      )}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <form
        className="station-menu__part"
        onSubmit={(event) => {
          event.preventDefault();
          if (!busy && code.trim() !== "") join(methodOf(code), code.trim());
        }}
      >
        {/* A scanner at the computer types what it reads, and Enter. */}
        <div data-takes-scans>
          <Field label={t("station.code")} hint={t("station.codeHint")} type="password" autoComplete="off" size="large" value={code} onChange={setCode} maxLength={100} autoFocus />
        </div>
        <Button type="submit" size="large" isDisabled={busy || code.trim() === ""}>
          {t("station.joinBy", { method: t("station.methods.badge") })}
        </Button>
      </form>
      <form
        className="station-menu__part"
        onSubmit={(event) => {
          event.preventDefault();
          if (!busy && pin.length >= MIN_PIN_DIGITS) join("pin", pin);
        }}
      >
        <PinPad label={t("pin.label")} value={pin} onChange={setPin} />
        <Button type="submit" kind="main" size="large" isDisabled={busy || pin.length < MIN_PIN_DIGITS}>
          {t("station.joinBy", { method: t("station.methods.pin") })}
        </Button>
      </form>
      <div className="confirm-dialog__actions">
        <Button onPress={() => setSigningOut(true)}>{t("station.signOut")}</Button>
        <Button onPress={onClose}>{t("close")}</Button>
      </div>
      {isSigningOut && (
        <PinDialog title={t("station.signOutOf", { station: station.name })} act={t("station.signOut")} onClose={() => setSigningOut(false)} onPin={onSignOut}>
          <p>{joined === null ? t("station.signOutEngineer") : t("station.signOutWho", { name: joined.name })}</p>
        </PinDialog>
      )}
    </div>
  );
}

function useSeen(isJoined: boolean): void {
  useEffect(() => {
    if (!isJoined) return;
    let saidAt = 0;
    const seen = () => {
      if (Date.now() - saidAt < SEEN_MS) return;
      saidAt = Date.now();
      requestService("accounts", "me/station/seen", { method: "POST" }).catch(() => undefined); // the next touch says it again
    };
    addEventListener("pointerdown", seen);
    addEventListener("keydown", seen);
    return () => {
      removeEventListener("pointerdown", seen);
      removeEventListener("keydown", seen);
    };
  }, [isJoined]);
}
