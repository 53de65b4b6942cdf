/** The states in which the work stands still, each with what to do. */
import { CloudOff, HandHelping, Hourglass, OctagonX, ServerCrash, Users, WifiOff } from "lucide-react";
import { useTranslation } from "react-i18next";
import { useLocation } from "wouter";
import { declareGlove } from "~/api/acts";
import { Button } from "~/design/Button";
import type { Situation } from "./situation";
import { Standstill } from "./Standstill";
import type { Acting } from "./useAct";
import type { OperatorActs } from "./useOperatorActs";

export interface TroubleProps {
  situation: Situation;
  acts: OperatorActs;
  acting: Acting;
  choose: (glove: string) => void;
}

export function Trouble({ situation, acts, acting, choose }: TroubleProps) {
  const { t } = useTranslation("work");
  const [, go] = useLocation();
  const main = acts.main !== null && (
    <Button size="large" kind="main" isDisabled={acting.busy} onPress={acts.main.do}>
      {acts.main.name}
    </Button>
  );
  switch (situation.kind) {
    case "connecting":
      return <Standstill tone="neutral" icon={<Hourglass aria-hidden />} title={t("connecting.title")} />;
    case "linkLost":
      return (
        <Standstill tone="stop" icon={<CloudOff aria-hidden />} title={t("linkLost.title")} means={t("linkLost.means")} todo={t("linkLost.do")} />
      );
    case "serviceLost":
      return (
        <Standstill
          tone="stop"
          icon={<ServerCrash aria-hidden />}
          title={t(`serviceLost.${situation.service}.title`)}
          means={t(`serviceLost.${situation.service}.means`)}
          todo={t("serviceLost.do")}
          detail={situation.detail}
        >
          <Button size="large" onPress={() => go("/system")}>
            {t("by.system")}
          </Button>
        </Standstill>
      );
    case "gloveLost":
      return (
        <Standstill
          tone="stop"
          icon={<WifiOff aria-hidden />}
          title={t("gloveLost.title", { glove: situation.glove.glove })}
          means={t("gloveLost.means", { task: situation.task.description })}
          todo={t("gloveLost.do")}
        >
          {main}
        </Standstill>
      );
    case "failed":
      return (
        <Standstill
          tone="stop"
          icon={<OctagonX aria-hidden />}
          title={t("failed.title", { title: situation.process.title })}
          means={t("failed.means")}
          todo={t(situation.process.retry === null ? "failed.noRetry" : "failed.retry")}
          detail={t("failed.reason", { reason: situation.process.reason ?? t("failed.unknown") })}
        >
          {main}
          {situation.process.retry !== null && <StartAgain situation={situation} acts={acts} acting={acting} />}
          <Button size="large" onPress={() => go(`/processes/${situation.process.id}`)}>
            {t("by.processes")}
          </Button>
        </Standstill>
      );
    case "noGlove": {
      const glove = situation.chosen ?? "glove-1";
      return (
        <Standstill
          tone="attention"
          icon={<HandHelping aria-hidden />}
          title={situation.chosen === null ? t("noGlove.title") : t("noGlove.titleOne", { glove })}
          means={t("noGlove.means")}
          todo={t("noGlove.do")}
        >
          {main}
          <Button size="large" isDisabled={acting.busy} onPress={() => acting.perform(() => declareGlove(glove))}>
            {t("by.screen")}
          </Button>
        </Standstill>
      );
    }
    case "chooseGlove":
      return (
        <Standstill tone="accent" icon={<Users aria-hidden />} title={t("choose.title")} means={t("choose.means")}>
          {situation.gloves.map((one) => (
            <Button key={one.glove} size="large" onPress={() => choose(one.glove)}>
              {t("by.choose", { name: one.person === null ? one.glove : `${one.person} (${one.glove})` })}
            </Button>
          ))}
        </Standstill>
      );
    default:
      return null;
  }
}

function StartAgain({ situation, acts, acting }: Omit<TroubleProps, "choose" | "situation"> & { situation: Extract<Situation, { kind: "failed" }> }) {
  const { t } = useTranslation("work");
  const again = situation.startable.find(({ name }) => name === situation.process.definition);
  if (again === undefined) return null;
  return (
    <Button size="large" isDisabled={acting.busy} onPress={() => acts.start?.(again)}>
      {t("by.startAgain", { title: again.title })}
    </Button>
  );
}
