/** The frame of the participant's pages: no navigation, and one button that pauses or withdraws. */
import { CirclePause } from "lucide-react";
import i18next from "i18next";
import { Suspense, useEffect, useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { useLocation, useSearchParams } from "wouter";
import { errorText } from "~/api/http";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Button } from "~/design/Button";
import { Field } from "~/design/Field";
import { ErrorMessage } from "~/design/ErrorMessage";
import { preferredLanguage } from "~/i18n";
import { addresses } from "~/places/addresses";
import { pauseGlove, resumeGlove } from "~/work/actions";
import { leaderCode, leaveParticipantMode, setPaused, type ParticipantMode } from "./participantMode";
import { deleteSession } from "./study";
import "~/shell/Shell.css";
import "./ParticipantFrame.css";

export default function ParticipantFrame({ mode, children }: { mode: ParticipantMode; children: ReactNode }) {
  const { t } = useTranslation("study", { lng: mode.language });
  const [path, go] = useLocation();
  const [query] = useSearchParams();
  const [withdrawn, setWithdrawn] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const atWork = path === addresses.work();
  const study = addresses.study({ session: mode.session });
  const isElsewhere = atWork
    ? mode.glove !== null && query.get("glove") !== mode.glove
    : path !== addresses.study() || query.get("session") !== mode.session;
  useEffect(() => {
    if (isElsewhere) go(atWork && mode.glove !== null ? addresses.work({ glove: mode.glove }) : study, { replace: true });
  }, [isElsewhere, atWork, study, mode.glove, go]);
  useEffect(() => {
    if (i18next.language !== mode.language) void i18next.changeLanguage(mode.language);
  }, [mode.language]);
  const pause = (paused: boolean) => {
    setFailure(null);
    setPaused(paused);
    if (mode.glove === null) return;
    (paused ? pauseGlove : resumeGlove)(mode.glove).catch((error: unknown) => setFailure(errorText(error)));
  };
  return (
    <div className="shell__side shell__side--alone">
      <header className="shell__bar participant-bar">
        <strong>{mode.pseudonym}</strong>
        <div className="participant-bar__actions">
          {atWork && !mode.paused && !withdrawn && (
            <Button size="large" onPress={() => go(study)}>
              {t("frame.back")}
            </Button>
          )}
          {!mode.paused && !withdrawn && (
            <Button size="large" icon={<CirclePause aria-hidden size="1.1em" />} onPress={() => pause(true)}>
              {t("frame.pause")}
            </Button>
          )}
        </div>
      </header>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <main id="content" className="shell__content" tabIndex={-1}>
        {withdrawn ? (
          <Withdrawn mode={mode} />
        ) : mode.paused ? (
          <Paused mode={mode} onContinue={() => pause(false)} onWithdrawn={() => setWithdrawn(true)} />
        ) : isElsewhere ? null : (
          <Suspense fallback={null}>{children}</Suspense>
        )}
      </main>
    </div>
  );
}

function Paused({ mode, onContinue, onWithdrawn }: { mode: ParticipantMode; onContinue: () => void; onWithdrawn: () => void }) {
  const { t } = useTranslation("study", { lng: mode.language });
  const [asking, setAsking] = useState(false);
  return (
    <section className="participant participant__end" lang={mode.language}>
      <CirclePause aria-hidden size={64} />
      <h1>{t("frame.paused")}</h1>
      <p>{t("frame.pausedMeans")}</p>
      <div className="participant__actions">
        <Button kind="main" size="large" onPress={onContinue}>
          {t("frame.continue")}
        </Button>
        <Button size="large" onPress={() => setAsking(true)}>
          {t("frame.withdraw")}
        </Button>
        <LeaveButton mode={mode} />
      </div>
      <ConfirmDialog
        isOpen={asking}
        onClose={() => setAsking(false)}
        title={t("frame.withdrawAsk")}
        act={t("frame.withdraw")}
        kind="stop"
        size="large"
        onAct={async () => {
          await deleteSession(mode.session);
          if (mode.glove !== null) await resumeGlove(mode.glove);
          onWithdrawn();
        }}
      >
        <p>{t("frame.withdrawMeans")}</p>
      </ConfirmDialog>
    </section>
  );
}

function Withdrawn({ mode }: { mode: ParticipantMode }) {
  const { t } = useTranslation("study", { lng: mode.language });
  return (
    <section className="participant participant__end" lang={mode.language}>
      <h1>{t("frame.withdrawn")}</h1>
      <p>{t("frame.withdrawnMeans")}</p>
      <LeaveButton mode={mode} />
    </section>
  );
}

/** Returns the screen to the study leader, who has the code. */
export function LeaveButton({ mode }: { mode: ParticipantMode }) {
  const { t } = useTranslation("study", { lng: mode.language });
  const [asking, setAsking] = useState(false);
  const [code, setCode] = useState("");
  return (
    <>
      <Button kind="quiet" size="large" onPress={() => setAsking(true)}>
        {t("frame.leader")}
      </Button>
      <ConfirmDialog
        isOpen={asking}
        onClose={() => setAsking(false)}
        title={t("frame.leader")}
        act={t("frame.leave")}
        size="large"
        isDisabled={code.trim() === ""}
        onAct={async () => {
          if (code.trim() !== leaderCode()) throw new Error(t("frame.wrongCode"));
          if (mode.glove !== null && mode.paused) await resumeGlove(mode.glove).catch(() => undefined);
          leaveParticipantMode();
          history.replaceState(null, "", addresses.study());
          await i18next.changeLanguage(preferredLanguage());
        }}
      >
        <Field label={t("frame.code")} value={code} onChange={setCode} inputMode="numeric" size="large" autoFocus />
      </ConfirmDialog>
    </>
  );
}
