/** Sign in, use a one-time link (`/join#…`), or ask for an account. Large targets: stations are used with gloves. */
import { useEffect, useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { errorText, request } from "~/api/http";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { useSession } from "./session";
import "./SignInPage.css";

const PRODUCT = "Handover";

interface LinkPreview {
  purpose: "owner" | "invitation" | "password";
  name: string | null;
}

const providerFaults = ["noAccount", "nameInUse", "expired", "failed"] as const;

function providerFault(given: string): (typeof providerFaults)[number] {
  return providerFaults.find((one) => one === given) ?? "failed";
}

const titles = { owner: "owner", invitation: "invitation", password: "passwordLink", join: "join" } as const;

export default function SignInPage() {
  const [asks, setAsks] = useState(false);
  const secret = location.pathname === "/join" ? location.hash.slice(1) : "";
  if (secret !== "") return <Join secret={secret} />;
  return asks ? <AskForAccount onBack={() => setAsks(false)} /> : <SignIn onAsk={() => setAsks(true)} />;
}

function SignIn({ onAsk }: { onAsk: () => void }) {
  const { t } = useTranslation("common");
  const { provider } = useSession();
  const fault = new URLSearchParams(location.hash.slice(1)).get("signIn");
  const [name, setName] = useState("");
  const [password, setPassword] = useState("");
  return (
    <Form
      title={t("session.signIn")}
      act={t("session.signIn")}
      onAct={async () => {
        await request("session", { method: "POST", json: { name, password } });
        enter();
      }}
      isDisabled={name.trim() === "" || password === ""}
      aside={
        <>
          {provider !== null && (
            <Button size="large" onPress={() => location.assign("/api/session/provider")}>
              {t("session.signInAt", { provider })}
            </Button>
          )}
          <Button kind="quiet" size="large" onPress={onAsk}>
            {t("session.ask")}
          </Button>
        </>
      }
    >
      {fault !== null && <ErrorMessage>{t(`session.providerFault.${providerFault(fault)}`)}</ErrorMessage>}
      <Field label={t("session.name")} value={name} onChange={setName} size="large" autoComplete="username" autoFocus maxLength={64} />
      <Field label={t("session.password")} value={password} onChange={setPassword} size="large" type="password" autoComplete="current-password" maxLength={200} />
    </Form>
  );
}

function Join({ secret }: { secret: string }) {
  const { t } = useTranslation("common");
  const [link, setLink] = useState<LinkPreview | null>(null);
  const [failure, setFailure] = useState<string | null>(null);
  const [name, setName] = useState("");
  const [password, setPassword] = useState("");
  useEffect(() => {
    request<LinkPreview>("session/link", { method: "POST", json: { link: secret } }).then(
      (found) => {
        setLink(found);
        setName((typed) => (typed === "" || found.purpose === "password" ? (found.name ?? "") : typed)); // the answer may come late
      },
      (error: unknown) => setFailure(errorText(error)),
    );
  }, [secret]);
  if (failure !== null) {
    return (
      <Frame title={t("session.join")}>
        <ErrorMessage>{failure}</ErrorMessage>
        <Button size="large" onPress={enter}>
          {t("session.signIn")}
        </Button>
      </Frame>
    );
  }
  const isNew = link?.purpose !== "password";
  return (
    <Form
      title={t(`session.${titles[link?.purpose ?? "join"]}`)}
      act={isNew ? t("session.create") : t("session.setPassword")}
      onAct={async () => {
        await request("session/link-use", { method: "POST", json: { link: secret, password, ...(isNew ? { name } : {}) } });
        enter();
      }}
      isDisabled={link === null || name.trim() === "" || password === ""}
    >
      <Field label={t("session.name")} value={name} onChange={setName} size="large" autoComplete="username" isReadOnly={!isNew} maxLength={64} />
      <Field
        label={t("session.newPassword")}
        hint={t("session.rule")}
        value={password}
        onChange={setPassword}
        size="large"
        type="password"
        autoComplete="new-password"
        maxLength={200}
      />
    </Form>
  );
}

function AskForAccount({ onBack }: { onBack: () => void }) {
  const { t } = useTranslation("common");
  const [name, setName] = useState("");
  const [contact, setContact] = useState("");
  const [note, setNote] = useState("");
  const [isSent, setSent] = useState(false);
  const back = (
    <Button kind="quiet" size="large" onPress={onBack}>
      {t("session.back")}
    </Button>
  );
  if (isSent) {
    return (
      <Frame title={t("session.ask")}>
        <p role="status">{t("session.asked")}</p>
        {back}
      </Frame>
    );
  }
  return (
    <Form
      title={t("session.ask")}
      act={t("session.sendRequest")}
      onAct={async () => {
        await request("session/request", { method: "POST", json: { name, contact, note } });
        setSent(true);
      }}
      isDisabled={name.trim().length < 2}
      aside={back}
    >
      <Field label={t("session.name")} value={name} onChange={setName} size="large" maxLength={64} />
      <Field label={t("session.contact")} value={contact} onChange={setContact} size="large" maxLength={200} />
      <Field label={t("session.note")} value={note} onChange={setNote} size="large" maxLength={1000} />
    </Form>
  );
}

interface FormProps {
  title: string;
  act: string;
  isDisabled: boolean;
  aside?: ReactNode;
  children: ReactNode;
  onAct: () => Promise<void>;
}

function Form({ title, act, isDisabled, aside, children, onAct }: FormProps) {
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const perform = async () => {
    setBusy(true);
    setFailure(null);
    try {
      await onAct();
    } catch (error) {
      setFailure(errorText(error));
    } finally {
      setBusy(false);
    }
  };
  return (
    <Frame title={title}>
      <form
        className="sign-in__form"
        onSubmit={(event) => {
          event.preventDefault();
          if (!busy && !isDisabled) void perform();
        }}
      >
        {children}
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        <Button kind="main" size="large" type="submit" isDisabled={busy || isDisabled}>
          {act}
        </Button>
        {aside}
      </form>
    </Frame>
  );
}

function Frame({ title, children }: { title: string; children: ReactNode }) {
  return (
    <main className="sign-in">
      <section className="sign-in__card">
        <p className="sign-in__product">{PRODUCT}</p>
        <h1>{title}</h1>
        {children}
      </section>
    </main>
  );
}

/** Load the page as the user who has signed in; the secret of a link leaves the address. */
function enter(): void {
  location.replace("/");
}
