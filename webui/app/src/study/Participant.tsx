/** The participant's view: one step at a time, in their language, stored as soon as it is answered. */
import { CircleCheck } from "lucide-react";
import { useEffect, useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { ErrorMessage } from "~/design/ErrorMessage";
import { About, Consent, Preference, Task } from "./Steps";
import { SusForm } from "./SusForm";
import { TlxForm } from "./TlxForm";
import "./Participant.css";
import { LeaveButton } from "./ParticipantFrame";
import { enterParticipantMode, useParticipantMode } from "./participantMode";
import { answerStep, sessionPath, type Session, type Wording } from "./study";

export interface StepProps {
  words: Wording;
  session: Session;
  busy: boolean;
  answer: (content: unknown) => void;
}

export function Participant({ session: id }: { session: string }) {
  const { i18n } = useTranslation("study");
  const { value: loaded, failure: lost } = useServiceQuery<Session>("study", sessionPath(id));
  const [moved, setMoved] = useState<Session | null>(null);
  const [failure, setFailure] = useState<string | null>(null);
  const [busy, setBusy] = useState(false);
  const session = moved ?? loaded;
  const { value: words } = useServiceQuery<Wording>("study", session === null ? null : `wording?language=${session.language}`);
  const { t } = useTranslation("study", { lng: session?.language ?? i18n.language });
  const answer = (content: unknown) => {
    if (session === null || busy) return;
    setBusy(true);
    setFailure(null);
    answerStep(id, session.step, content)
      .then((next) => {
        setMoved(next.step === "declined" ? { ...session, step: next.step } : next);
        window.scrollTo({ top: 0 });
      })
      .catch((error: unknown) => setFailure(errorText(error)))
      .finally(() => setBusy(false));
  };
  const mode = useParticipantMode();
  useEffect(() => {
    // Enter the participant's mode.
    if (loaded !== null) enterParticipantMode({ session: loaded.id, glove: loaded.glove, language: loaded.language, pseudonym: loaded.pseudonym });
  }, [loaded]);
  if (lost !== null) return <ErrorMessage act={mode === null ? null : <LeaveButton mode={mode} />}>{lost}</ErrorMessage>;
  if (session === null || words === null) return null;
  return (
    <div className="participant" lang={session.language}>
      <header className="participant__head">
        <p>
          {t("sessions.at", { step: session.stepNumber, steps: session.steps })}
        </p>
        <progress max={session.steps} value={session.step === "finished" ? session.steps : session.stepNumber - 1} aria-label={t("progress")} />
      </header>
      <section className="participant__step" key={session.step}>
        <Step session={session} words={words} answer={answer} busy={busy} />
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      </section>
    </div>
  );
}

function Step(props: StepProps) {
  const { session, words } = props;
  const mode = useParticipantMode();
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
          <p>{t(session.step === "declined" ? "thanks.declined" : "thanks.means")}</p>
          {mode !== null && <LeaveButton mode={mode} />}
        </div>
      );
  }
}
