/** A running test: the requested hand and the result of the previous trial. */
import { Check, CircleX, Hand as HandIcon, RotateCcw, TriangleAlert } from "lucide-react";
import { memo, useState } from "react";
import { useTranslation } from "react-i18next";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { number } from "~/design/numbers";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Hand, useGestureName } from "~/hand/Hand";
import { useTopic } from "~/live/hooks";
import type { AccuracyTest } from "~/live/messages";
import { leadTest } from "./tests";

const icons = { right: Check, corrected: RotateCcw, missed: CircleX };

export function Trial({ glove }: { glove: string }) {
  const view = useTopic(`glove/${glove}`);
  if (view?.accuracyTest == null) return null;
  return <Stage accuracyTest={view.accuracyTest} side={view.hand} states={view.states} isConnected={view.connected} />;
}

interface StageProps {
  accuracyTest: AccuracyTest;
  side: "left" | "right";
  states: string | null;
  isConnected: boolean;
}

function Stage({ accuracyTest, side, states, isConnected }: StageProps) {
  const { t } = useTranslation("test");
  const nameOf = useGestureName();
  const [failure, setFailure] = useState<string | null>(null);
  const { id, phase, asked, done, trials, round } = accuracyTest;
  const waits = phase === "break" || phase === "interrupted";
  const lead = (act: "continue" | "stop") => {
    setFailure(null);
    leadTest(id, act).catch((error: unknown) => setFailure(errorText(error)));
  };
  const holdPart = Math.min(1, accuracyTest.heldMs / accuracyTest.holdMs);
  const title = asked === null ? t(`trial.${waits ? phase : "rest"}.title`) : nameOf(asked.gesture);
  return (
    <section className="trial" data-phase={phase}>
      <div className="trial__figure">
        <RequestedHand code={asked?.code ?? "00000"} side={side} label={title} />
      </div>
      <div className="trial__words">
        <p className="trial__how">{asked === null ? t("trial.wait") : t("trial.show")}</p>
        <h2 className="trial__what">{title}</h2>
        {asked === null && <p className="trial__said">{t(`trial.${waits ? phase : "rest"}.means`)}</p>}
        {asked !== null && (
          <div className="trial__held" role="presentation">
            <div style={{ inlineSize: `${holdPart * 100}%` }} />
          </div>
        )}
        {!isConnected && !waits && <ErrorMessage>{t("trial.away")}</ErrorMessage>}
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        <div className="trial__actions">
          {waits && (
            <Button kind="main" size="large" onPress={() => lead("continue")}>
              {t("trial.continue")}
            </Button>
          )}
          <Button size="large" onPress={() => lead("stop")}>
            {t("trial.stop")}
          </Button>
        </div>
        <div className="trial__now">
          {states === null ? <HandIcon aria-hidden size={48} /> : <Hand states={states} side={side} moveMs={140} size="clamp(96px, 16vh, 170px)" />}
          <Last last={accuracyTest.last} />
        </div>
      </div>
      <footer className="trial__footer">
        <progress max={trials} value={done} aria-label={t("trial.progress")} />
        <p>{t("trial.count", { done, trials, round, rounds: accuracyTest.rounds })}</p>
      </footer>
    </section>
  );
}

const RequestedHand = memo(function RequestedHand({ code, side, label }: { code: string; side: "left" | "right"; label: string }) {
  return <Hand key={code} states={code} side={side} animateFrom="00000" size="100%" label={label} />;
});

function Last({ last }: { last: AccuracyTest["last"] }) {
  const { t, i18n } = useTranslation("test");
  const nameOf = useGestureName();
  if (last === null) return <p role="status" />;
  const Icon = last.first === "no gesture" ? TriangleAlert : icons[last.outcome];
  const ms = last.recognizedMs;
  return (
    <p role="status" className={`trial__last trial__last--${last.outcome}`}>
      <Icon aria-hidden size={24} />
      <span>
        {t(`trial.last.${last.outcome}`, { gesture: nameOf(last.asked), ...(ms === null ? {} : { seconds: number(ms / 1000, i18n.language, { minimumFractionDigits: 1, maximumFractionDigits: 1 }) }) })}
      </span>
    </p>
  );
}
