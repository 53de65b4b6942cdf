/** Who is signed in: change the password, sign out. In local mode there is nothing to show. */
import { UserRound } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { errorText, request } from "~/api/http";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { useSession } from "./session";
import { signOut } from "./signOut";
import { StationMenu } from "./StationMenu";
import "~/design/ConfirmDialog.css";

export function AccountMenu() {
  const { t } = useTranslation("common");
  const { hasAccounts, user } = useSession();
  const [isOpen, setOpen] = useState(false);
  if (!hasAccounts || user === null) return null;
  if (user.isStation) return <StationMenu onSignOut={signOutStation} />;
  return (
    <>
      <Button kind="quiet" label={t("session.account", { name: user.name })} icon={<UserRound aria-hidden size={20} />} onPress={() => setOpen(true)} />
      <ModalOverlay className="confirm-dialog__overlay" isOpen={isOpen} onOpenChange={setOpen} isDismissable>
        <Modal className="confirm-dialog">
          <Dialog className="confirm-dialog__dialog confirm-dialog__form">
            <Heading slot="title" className="confirm-dialog__title">
              {user.name}
            </Heading>
            <ChangePassword />
            <div className="confirm-dialog__actions">
              <Button size="large" onPress={() => setOpen(false)}>
                {t("close")}
              </Button>
              <Button kind="main" size="large" onPress={() => void signOut()}>
                {t("session.signOut")}
              </Button>
            </div>
          </Dialog>
        </Modal>
      </ModalOverlay>
    </>
  );
}

function ChangePassword() {
  const { t } = useTranslation("common");
  const [current, setCurrent] = useState("");
  const [next, setNext] = useState("");
  const [result, setResult] = useState<{ failure: string | null } | null>(null);
  const perform = async () => {
    try {
      await request("session/password", { method: "PUT", json: { current, new: next } });
      setCurrent("");
      setNext("");
      setResult({ failure: null });
    } catch (error) {
      setResult({ failure: errorText(error) });
    }
  };
  return (
    <form
      className="confirm-dialog__form"
      onSubmit={(event) => {
        event.preventDefault();
        if (current !== "" && next !== "") void perform();
      }}
    >
      <Field label={t("session.currentPassword")} value={current} onChange={setCurrent} type="password" autoComplete="current-password" maxLength={200} />
      <Field label={t("session.newPassword")} hint={t("session.rule")} value={next} onChange={setNext} type="password" autoComplete="new-password" maxLength={200} />
      {result !== null && (result.failure === null ? <p role="status">{t("session.changed")}</p> : <ErrorMessage>{result.failure}</ErrorMessage>)}
      <Button type="submit" isDisabled={current === "" || next === ""}>
        {t("session.changePassword")}
      </Button>
    </form>
  );
}

/** Sign a station out; rejects for a PIN that may not. */
async function signOutStation(pin: string): Promise<void> {
  await request("session", { method: "DELETE", json: { pin } });
  location.replace("/");
}
