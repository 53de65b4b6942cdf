/** The guide of the first steps: the one next step, large; done steps are ticked, and with the last one the guide is gone. */
import { Check, CircleCheck, X } from "lucide-react";
import { useEffect, useState } from "react";
import { useTranslation } from "react-i18next";
import { Link, useLocation } from "wouter";
import { useUsers } from "~/accounts/accounts";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { CopyButton } from "~/design/CopyButton";
import { ErrorMessage } from "~/design/ErrorMessage";
import { useFamily, useTopic } from "~/live/hooks";
import { useRobotNames } from "~/live/names";
import { mayDo, useSession } from "~/session/session";
import { useHomeGloves } from "./gloves";
import { setGuideState } from "./guideState";
import { nextStep, offeredSteps, type Facts, type Step, type StepAct } from "./steps";
import "./Guide.css";

function useFacts(services: readonly string[]): Facts {
  const { hasAccounts } = useSession();
  const { users } = useUsers(hasAccounts && mayDo("managePeople"));
  return {
    services,
    up: (useTopic("services") ?? []).filter(({ state }) => state === "up").map(({ name }) => name),
    gloves: useHomeGloves(),
    robots: useRobotNames(),
    definitions: useFamily("definition"),
    hasProcess: useFamily("process").length > 0,
    operator: useTopic("operator") ?? null,
    hasAccounts,
    people: users?.length ?? null,
  };
}

export default function Guide({ services, isWanted }: { services: readonly string[]; isWanted: boolean }) {
  const { t } = useTranslation("home");
  const facts = useFacts(services);
  const offered = offeredSteps(facts);
  const next = nextStep(facts);
  const isKnown = !facts.hasAccounts || !mayDo("managePeople") || facts.people !== null;
  const isFollowed = isKnown && next === null;
  const isHidden = isFollowed && !isWanted;
  useEffect(() => {
    if (isHidden && offered.length > 0) setGuideState("followed");
  }, [isHidden, offered.length]);
  if (isHidden || !isKnown) return null;
  return (
    <section className="guide" aria-labelledby="guide">
      <header className="guide__head">
        <h2 id="guide">{t("guide.title")}</h2>
        <ol className="guide__steps">
          {offered.map((step) => (
            <Tick key={step.name} step={step} facts={facts} isNext={step === next} />
          ))}
        </ol>
        <Button kind="quiet" icon={<X aria-hidden size={18} />} onPress={() => setGuideState("dismissed")}>
          {t("guide.hide")}
        </Button>
      </header>
      {next === null ? (
        <p className="home__fine">
          <CircleCheck aria-hidden size={20} /> {t("guide.followed")}
        </p>
      ) : (
        <NextStep key={next.name} step={next} facts={facts} />
      )}
      <p role="status" className="visually-hidden">
        {next === null ? t("guide.followed") : t("guide.next", { step: t(`step.${next.name}.title`) })}
      </p>
    </section>
  );
}

function Tick({ step, facts, isNext }: { step: Step; facts: Facts; isNext: boolean }) {
  const { t } = useTranslation("home");
  const isDone = step.isDone(facts);
  const to = isDone ? (step.see?.(facts) ?? null) : null;
  const name = t(`step.${step.name}.short`);
  return (
    <li className="guide__tick" data-done={isDone || undefined} aria-current={isNext ? "step" : undefined}>
      {isDone && <Check aria-hidden size={16} />}
      {to === null ? name : <Link href={to}>{name}</Link>}
      {isDone && <span className="visually-hidden">{t("guide.done")}</span>}
    </li>
  );
}

function NextStep({ step, facts }: { step: Step; facts: Facts }) {
  const { t } = useTranslation("home");
  const [, go] = useLocation();
  const [isBusy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const isPending = step.isPending?.(facts) === true;
  const fault = step.faultOf?.(facts) ?? null;
  const command = step.commandOf?.(facts) ?? null;
  const act = ({ to, run, ends }: StepAct) => {
    if (ends === true) setGuideState("dismissed");
    if (to !== undefined) go(to);
    if (run === undefined) return;
    setBusy(true);
    setFailure(null);
    void run()
      .then((address) => address !== null && go(address))
      .catch((error: unknown) => setFailure(errorText(error)))
      .finally(() => setBusy(false));
  };
  return (
    <div className="guide__step">
      <span className="guide__icon">
        <step.icon aria-hidden size={40} />
      </span>
      <div className="guide__words">
        <h3>{t(`step.${step.name}.title`)}</h3>
        <p>{t(`step.${step.name}.${step.whatOf?.(facts) ?? "what"}`)}</p>
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        {isPending && <p className="quiet">{t(`step.${step.name}.pending`)}</p>}
        {fault !== null && <p className="quiet small">{fault}</p>}
        <div className="guide__acts">
          {step.acts(facts).map((offer, index) => (
            <Button key={offer.name} permission={offer.permission} kind={index === 0 ? "main" : "plain"} isDisabled={isBusy || isPending} onPress={() => act(offer)}>
              {t(`act.${offer.name}`, offer.values ?? {})}
            </Button>
          ))}
        </div>
        {command !== null && (
          <div className="guide__terminal quiet small">
            <span>{t(`step.${step.name}.terminal`)}</span>
            <code>{command}</code>
            <CopyButton text={command}>{t("guide.copy")}</CopyButton>
          </div>
        )}
      </div>
    </div>
  );
}
