/** First steps: a glove, a robot and a process, and whether each is ready. */
import { Bot, Hand, Play, Workflow, X } from "lucide-react";
import { useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Link, useLocation } from "wouter";
import { startOperator, startProcess, stopOperator } from "~/api/actions";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { deviceTone } from "~/design/states";
import { useFamily, useTopic } from "~/live/hooks";
import { addresses } from "~/places/addresses";
import { MayNot } from "~/session/MayNot";

const DEMO = "bin-picking";
const DEFAULT_GLOVE = "glove-1";

export function FirstSteps({ onDismiss }: { onDismiss: () => void }) {
  const { t } = useTranslation("common");
  return (
    <section className="start__first" aria-labelledby="first-steps">
      <header className="start__first-head">
        <h2 id="first-steps">{t("start.lead")}</h2>
        <Button kind="quiet" icon={<X aria-hidden size={18} />} onPress={onDismiss}>
          {t("start.dismiss")}
        </Button>
      </header>
      <div className="start__cards">
        <ProcessCard />
        <GloveCard />
        <RobotCard />
      </div>
    </section>
  );
}

function ProcessCard() {
  const { t } = useTranslation("common");
  const definition = useTopic(`definition/${DEMO}`);
  const running = useFamily("process").some((process) => process.definition === DEMO && process.endedAt === null);
  const [, go] = useLocation();
  const { busy, failure, perform } = useAction();
  const isReady = definition !== undefined && definition.unusable === undefined;
  const state = running ? (
    <StatusBadge tone="accent">{t("start.process.running")}</StatusBadge>
  ) : isReady ? (
    <StatusBadge tone="ok">{t("start.process.ready")}</StatusBadge>
  ) : (
    <StatusBadge tone="stop">{t("start.process.notReady")}</StatusBadge>
  );
  return (
    <StartCard title={t("start.process.title")} icon={<Workflow aria-hidden size={22} />} state={state}>
      <p>{t("start.process.what")}</p>
      <MayNot permission="runProcesses" />
      {!isReady && <p className="quiet">{definition?.unusable ?? t("start.process.missing")}</p>}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {running ? (
        <Button kind="main" onPress={() => go(addresses.work())}>
          {t("start.process.see")}
        </Button>
      ) : (
        <Button permission="runProcesses"
          kind="main"
          icon={<Play aria-hidden size={18} />}
          isDisabled={!isReady || busy}
          onPress={() => perform(async () => {
            await startProcess(DEMO);
            go(addresses.work());
          })}
        >
          {t("start.process.act")}
        </Button>
      )}
    </StartCard>
  );
}

function GloveCard() {
  const { t } = useTranslation("common");
  const gloves = useFamily("glove");
  const operator = useTopic("operator");
  const { busy, failure, perform } = useAction();
  const connected = gloves.find((glove) => glove.connected);
  const firstGlove = connected ?? gloves[0];
  const state =
    connected !== undefined ? (
      <StatusBadge tone="ok">{t("start.glove.connected", { glove: connected.glove })}</StatusBadge>
    ) : firstGlove !== undefined ? (
      <StatusBadge tone="attention">{t("start.glove.waiting", { glove: firstGlove.glove })}</StatusBadge>
    ) : (
      <StatusBadge tone="neutral">{t("start.glove.none")}</StatusBadge>
    );
  return (
    <StartCard title={t("start.glove.title")} icon={<Hand aria-hidden size={22} />} state={state}>
      <p>{t("start.glove.what")}</p>
      {operator?.detail != null && <p className="quiet">{operator.detail}</p>}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {operator?.running === true ? (
        <Button permission="configure" isDisabled={busy} onPress={() => perform(stopOperator)}>
          {t("start.glove.stop")}
        </Button>
      ) : (
        connected === undefined && (
          <Button permission="configure" isDisabled={busy || operator === undefined} onPress={() => perform(() => startOperator(firstGlove?.glove ?? DEFAULT_GLOVE))}>
            {t("start.glove.simulate")}
          </Button>
        )
      )}
      <Command words={t("start.glove.real")}>{".venv/bin/handover glove serial /dev/ttyUSB0"}</Command>
    </StartCard>
  );
}

function RobotCard() {
  const { t } = useTranslation("common");
  const [robot] = useFamily("robot");
  const state =
    robot === undefined ? (
      <StatusBadge tone="neutral">{t("start.robot.none")}</StatusBadge>
    ) : (
      <StatusBadge tone={deviceTone[robot.deviceState]}>
        {t("start.robot.ready", { robot: robot.id, state: t(`deviceState.${robot.deviceState}`) })}
      </StatusBadge>
    );
  return (
    <StartCard title={t("start.robot.title")} icon={<Bot aria-hidden size={22} />} state={state}>
      <p>{t("start.robot.what")}</p>
      {robot === undefined ? (
        <Command words={t("start.robot.start")}>{".venv/bin/handover run trajectory-tool"}</Command>
      ) : (
        <Link href={addresses.robots()}>{t("start.robot.see")}</Link>
      )}
    </StartCard>
  );
}

function StartCard({ title, icon, state, children }: { title: string; icon: ReactNode; state: ReactNode; children: ReactNode }) {
  return (
    <Card className="start__card" title={<span className="start__name">{icon}{title}</span>}>
      <div>{state}</div>
      {children}
    </Card>
  );
}

function Command({ words, children }: { words: string; children: string }) {
  return (
    <p className="quiet small">
      {words}
      <code className="start__command">{children}</code>
    </p>
  );
}

/** The action of a card: one at a time; its error is shown on the card. */
function useAction() {
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const perform = (act: () => Promise<unknown>) => {
    setBusy(true);
    setFailure(null);
    void act()
      .catch((error: unknown) => setFailure(errorText(error)))
      .finally(() => setBusy(false));
  };
  return { busy, failure, perform };
}
