/** A glove: wearer, rates, present gesture, and the switches of its controller. */
import { lazy, Suspense, useState } from "react";
import { useTranslation } from "react-i18next";
import { SwitchButton, SwitchField, Text } from "react-aria-components";
import { requestService, errorText } from "~/api/http";
import { Card } from "~/design/Card";
import { number } from "~/design/numbers";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { deviceTone } from "~/design/states";
import { rate } from "~/design/times";
import { Hand, useGestureName } from "~/hand/Hand";
import { useNow } from "~/live/clock";
import { useLive, useTopicSelector } from "~/live/hooks";
import { shortName } from "~/live/urn";
import { MayNot } from "~/design/MayNot";
import { mayDo } from "~/session/session";
import { Battery } from "../Battery";
import "./GloveCard.css";

const BendStrip = lazy(() => import("./BendStrip"));

const FINGERS_UNSEEN = "00000";

export function GloveCard({ glove }: { glove: string }) {
  const { t } = useTranslation(["system", "common"]);
  const state = useTopicSelector(`glove/${glove}`, (view) => view?.deviceState);
  const isConnected = useTopicSelector(`glove/${glove}`, (view) => view?.connected) === true;
  return (
    <Card
      className="glove"
      title={glove}
      aside={
        <span className="glove__states">
          {isConnected ? <StatusBadge tone="ok">{t("glove.connected")}</StatusBadge> : <StatusBadge tone="attention">{t("glove.away")}</StatusBadge>}
          {state !== undefined && <StatusBadge tone={deviceTone[state]}>{t(`common:deviceState.${state}`)}</StatusBadge>}
        </span>
      }
    >
      <div className="glove__body">
        <LiveHand glove={glove} />
        <Facts glove={glove} />
        <Modes glove={glove} />
      </div>
      <Suspense fallback={<div className="bend-strip__room" />}>
        <BendStrip glove={glove} />
      </Suspense>
    </Card>
  );
}

function LiveHand({ glove }: { glove: string }) {
  const { t } = useTranslation("system");
  const gestureName = useGestureName();
  const hand = useTopicSelector(`glove/${glove}`, (view) => view?.hand) ?? "right";
  const states = useTopicSelector(`glove/${glove}`, (view) => view?.states ?? null);
  const gesture = useTopicSelector(`glove/${glove}`, (view) => view?.gesture ?? null);
  return (
    <figure className="glove__hand" data-unseen={states === null || undefined}>
      <Hand states={states ?? FINGERS_UNSEEN} side={hand} size="148px" moveMs={120} />
      <figcaption>{states === null ? t("glove.unseen") : gesture === null ? t("glove.noGesture") : gestureName(gesture)}</figcaption>
    </figure>
  );
}

function Facts({ glove }: { glove: string }) {
  const { t } = useTranslation("system");
  const topic = `glove/${glove}` as const;
  const hand = useTopicSelector(topic, (view) => view?.hand) ?? "right";
  const person = useTopicSelector(topic, (view) => view?.person ?? null);
  const battery = useTopicSelector(topic, (view) => view?.battery ?? null);
  const task = useTopicSelector(topic, (view) => view?.task?.description ?? null);
  return (
    <dl className="facts">
      <Fact name={t("glove.hand")}>{t(`glove.side.${hand}`)}</Fact>
      <Fact name={t("glove.person")}>{person === null ? t("glove.nobody") : shortName(person)}</Fact>
      <Fact name={t("glove.battery")}>{battery === null ? t("glove.noBattery") : <Battery level={battery} />}</Fact>
      <Signal glove={glove} />
      <Fact name={t("glove.task")}>{task ?? t("glove.noTask")}</Fact>
      <LastAnswer glove={glove} />
    </dl>
  );
}

function Fact({ name, children }: { name: string; children: React.ReactNode }) {
  return (
    <div>
      <dt>{name}</dt>
      <dd>{children}</dd>
    </div>
  );
}

/** Counters are updated once a second, not with every frame. */
function Signal({ glove }: { glove: string }) {
  const { t, i18n } = useTranslation("system");
  const live = useLive();
  useNow();
  const view = live.value(`glove/${glove}`);
  if (view === undefined) return null;
  const dropped = Object.entries(view.droppedBy);
  return (
    <>
      <Fact name={t("glove.signal")}>
        {t("glove.frames", { rate: rate(view.connected ? view.rate_hz : 0, i18n.language), count: view.frames, frames: number(view.frames, i18n.language) })}
      </Fact>
      <Fact name={t("glove.dropped")}>
        {dropped.length === 0
          ? t("glove.noneDropped")
          : dropped
              .map(([why, count]) => `${number(count, i18n.language)} × ${t(`glove.why.${why}`, { defaultValue: why })}`)
              .join(", ")}
      </Fact>
    </>
  );
}

function LastAnswer({ glove }: { glove: string }) {
  const { t } = useTranslation("system");
  const gestureName = useGestureName();
  const gesture = useTopicSelector(`glove/${glove}`, (view) => view?.answered?.gesture ?? null);
  const by = useTopicSelector(`glove/${glove}`, (view) => view?.answered?.by ?? null);
  const operator = useTopicSelector(`glove/${glove}`, (view) => view?.answered?.operator ?? null);
  const words =
    by === null || gesture === null
      ? t("glove.noAnswer")
      : by === "screen"
        ? t("glove.byScreen", { operator: operator ?? t("glove.somebody") })
        : gestureName(gesture);
  return <Fact name={t("glove.answered")}>{words}</Fact>;
}

function Modes({ glove }: { glove: string }) {
  const { t } = useTranslation("system");
  const [failure, setFailure] = useState<string | null>(null);
  const testing = useTopicSelector(`glove/${glove}`, (view) => view?.testing) === true;
  const filtering = useTopicSelector(`glove/${glove}`, (view) => view?.filtering) === true;
  const put = (modes: { testing: boolean } | { filtering: boolean }) => {
    setFailure(null);
    requestService("gesture-controller", `gloves/${encodeURIComponent(glove)}/modes`, { method: "PUT", json: modes }).catch(
      (error: unknown) => setFailure(errorText(error)),
    );
  };
  return (
    <div className="glove__modes">
      <Mode name={t("glove.testing")} means={t("glove.testingMeans")} isOn={testing} onChange={(on) => put({ testing: on })} />
      <Mode name={t("glove.filtering")} means={t(filtering ? "glove.filteringMeans" : "glove.filteringOff")} isOn={filtering} onChange={(on) => put({ filtering: on })} />
      <MayNot permission="configure" />
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </div>
  );
}

/** The switch shows the state of the controller: it moves once the controller has applied the change. */
function Mode({ name, means, isOn, onChange }: { name: string; means: string; isOn: boolean; onChange: (on: boolean) => void }) {
  const { t } = useTranslation("system");
  return (
    <SwitchField className="switch" isSelected={isOn} isDisabled={!mayDo("configure")} onChange={onChange}>
      <SwitchButton className="switch__button">
        <span className="switch__track" aria-hidden>
          <span className="switch__knob" />
        </span>
        <span className="switch__name">{name}</span>
        <span className="quiet">{isOn ? t("on") : t("off")}</span>
      </SwitchButton>
      <Text slot="description" className="switch__means">
        {means}
      </Text>
    </SwitchField>
  );
}
