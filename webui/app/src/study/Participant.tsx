/** For who takes part: one step at a time, in their own language, kept as soon as it is answered. */
import { CircleCheck } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { describe } from "~/api/http";
import { useLoaded } from "~/api/useLoaded";
import { Button } from "~/design/Button";
import { Problem } from "~/design/Problem";
import { About, Consent, Preference, Task } from "./Steps";
import { SusForm } from "./SusForm";
import { TlxForm } from "./TlxForm";
import { answerStep, sessionPath, type Session, type Wording } from "./study";

export interface StepProps {
  words: Wording;
  session: Session;
  busy: boolean;
  answer: (content: unknown) => void;
}

export function Participant({ session: id, leave }: { session: string; leave: () => void }) {
  const { i18n } = useTranslation("study");
  const { value: loaded, failure: lost } = useLoaded<Session>("gesture-controller", sessionPath(id));
  const [moved, setMoved] = useState<Session | null>(null);
  const [failure, setFailure] = useState<string | null>(null);
  const [busy, setBusy] = useState(false);
  const session = moved ?? loaded;
  const { value: words } = useLoaded<Wording>("gesture-controller", session === null ? null : `study/wording?language=${session.language}`);
  const { t } = useTranslation("study", { lng: session?.language ?? i18n.language });
  const answer = (content: unknown) => {
    if (session === null || busy) return;
    setBusy(true);
    setFailure(null);
    answerStep(id, session.step, content)
      .then((next) => {
        if (next.step === "declined") leave();
        else {
          setMoved(next);
          window.scrollTo({ top: 0 });
        }
      })
      .catch((error: unknown) => setFailure(describe(error)))
      .finally(() => setBusy(false));
  };
  if (lost !== null) return <Problem act={<Button onPress={leave}>{t("leave")}</Button>}>{lost}</Problem>;
  if (session === null || words === null) return null;
  return (
    <div className="participant" lang={session.language}>
      <header className="participant__head">
        <p>
          {session.pseudonym} · {t("sessions.at", { step: session.stepNumber, steps: session.steps })}
        </p>
        <progress max={session.steps} value={session.step === "finished" ? session.steps : session.stepNumber - 1} aria-label={t("progress")} />
        <Button kind="quiet" onPress={leave}>
          {t("leave")}
        </Button>
      </header>
      <section className="participant__step" key={session.step}>
        <Step session={session} words={words} answer={answer} busy={busy} leave={leave} />
        {failure !== null && <Problem>{failure}</Problem>}
      </section>
    </div>
  );
}

function Step({ leave, ...props }: StepProps & { leave: () => void }) {
  const { session, words } = props;
  const { t } = useTranslation("study", { lng: session.language });
  switch (session.step) {
    case "consent":
      return <Consent {...props} />;
    case "introduction":
      return <About {...props} />;
    case "sample":
      return <Task {...props} {...words.steps.sample} />;
    case "interaction1":
    case "interaction2":
      return <Task {...props} {...words.steps.interaction[session.condition ?? "predefined"]} />;
    case "sus":
      return <SusForm {...props} />;
    case "tlx1":
    case "tlx2":
      return <TlxForm {...props} />;
    case "preference":
      return <Preference {...props} />;
    default:
      return (
        <div className="participant__end">
          <CircleCheck aria-hidden size={64} />
          <h1>{t("thanks.title")}</h1>
          <p>{t("thanks.means")}</p>
          <Button size="large" onPress={leave}>
            {t("leave")}
          </Button>
        </div>
      );
  }
}
