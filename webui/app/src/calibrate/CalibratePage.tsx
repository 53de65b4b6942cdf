/** The Calibrate page: how a glove fits the hand that wears it, finger by finger, over the live signal. */
import { lazy, Suspense, useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { callService, describe } from "~/api/http";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { Choice } from "~/design/Choice";
import { Problem } from "~/design/Problem";
import { State } from "~/design/State";
import { GlovePick, NoGlove, useChosenGlove } from "~/glove/ChosenGlove";
import { fingers } from "~/hand/geometry";
import { usePick } from "~/live/hooks";
import { shortName } from "~/live/urn";
import { useQuery } from "~/route/query";
import { useKeys } from "~/shell/keys";
import { bounds, changesOf, moved, steps, topOf, type Bound, type Step, type Thresholds } from "./draft";
import { FingerColumn } from "./FingerColumn";
import { GuidedCard } from "./GuidedCard";
import "./CalibratePage.css";

const LivePlot = lazy(() => import("./LivePlot"));

export default function CalibratePage() {
  const { t } = useTranslation("calibrate");
  const glove = useChosenGlove();
  return (
    <div className="calibrate">
      <header className="calibrate__head">
        <h1>{t("title")}</h1>
        {glove !== undefined && (
          <>
            <GlovePick glove={glove} />
            <Wearer glove={glove} />
          </>
        )}
      </header>
      {glove === undefined ? (
        <NoGlove means={t("none")} />
      ) : (
        <div className="calibrate__ways" key={glove}>
          <GuidedCard glove={glove} />
          <ByHand glove={glove} />
        </div>
      )}
    </div>
  );
}

function Wearer({ glove }: { glove: string }) {
  const { t } = useTranslation("calibrate");
  const person = usePick(`glove/${glove}`, (view) => view?.person ?? null);
  const isConnected = usePick(`glove/${glove}`, (view) => view?.connected) === true;
  return (
    <p className="calibrate__wearer">
      {isConnected ? <State tone="ok">{t("connected")}</State> : <State tone="attention">{t("away")}</State>}
      <span className="quiet">{person === null ? t("nobody") : t("worn", { person: shortName(person) })}</span>
    </p>
  );
}

/** Thresholds by hand: changed here, and counting only once they are saved. */
function ByHand({ glove }: { glove: string }) {
  const { t } = useTranslation(["calibrate", "hand"]);
  const told = usePick(`glove/${glove}`, (view) => (view === undefined ? "" : JSON.stringify(view.thresholds)));
  const saved = useMemo(() => (told === "" ? null : (JSON.parse(told) as Thresholds)), [told]);
  const [draft, setDraft] = useState<Thresholds | null>(null);
  const [step, setStep] = useQuery("step", "25");
  const [bound, setBound] = useQuery("bound", "upper");
  const [asked, setFinger] = useQuery("finger", "thumb");
  const [failure, setFailure] = useState<string | null>(null);
  const [said, setSaid] = useState<"saved" | "restored" | null>(null);
  const finger = fingers.find((one) => one === asked) ?? "thumb";
  const chosenBound: Bound = bounds.find((one) => one === bound) ?? "upper";
  const size = Number(steps.find((one) => one === step) ?? "25");
  const thresholds = draft ?? saved;
  const changes = saved !== null && draft !== null ? changesOf(saved, draft) : null;

  const move = (of: (typeof fingers)[number], which: Bound, to: number) => {
    if (thresholds === null) return;
    setSaid(null);
    setDraft(moved(thresholds, of, which, to));
  };
  const forget = () => {
    setDraft(null);
    setFailure(null);
  };
  const act = async (path: string, method: "PUT" | "POST", words: "saved" | "restored", json?: unknown) => {
    setFailure(null);
    try {
      await callService("gesture-controller", `gloves/${encodeURIComponent(glove)}/${path}`, { method, ...(json === undefined ? {} : { json }) });
      setDraft(null);
      setSaid(words);
    } catch (error) {
      setFailure(describe(error));
    }
  };
  const save = () => {
    if (changes !== null) void act("thresholds", "PUT", "saved", changes);
  };
  const restore = () => void act("thresholds/restore", "POST", "restored");
  const choose = (by: number) => setFinger(fingers[(fingers.indexOf(finger) + by + fingers.length) % fingers.length] ?? "thumb");
  const nudge = (by: number) => {
    if (thresholds !== null) move(finger, chosenBound, thresholds[finger][chosenBound] + by);
  };
  useKeys([
    { key: "ArrowLeft", does: t("keys.left"), act: () => choose(-1) },
    { key: "ArrowRight", does: t("keys.right"), act: () => choose(1) },
    { key: "u", does: t("keys.upper"), act: () => setBound("upper") },
    { key: "l", does: t("keys.lower"), act: () => setBound("lower") },
    { key: "ArrowUp", does: t("keys.up"), act: () => nudge(size) },
    { key: "ArrowDown", does: t("keys.down"), act: () => nudge(-size) },
    { key: "s", does: t("keys.save"), act: save },
    { key: "z", does: t("keys.back"), act: forget },
  ]);
  if (saved === null || thresholds === null) return null;

  return (
    <Card
      title={t("byHand")}
      aside={<Choice<Step> label={t("step")} value={String(size) as Step} options={steps.map((one) => ({ value: one, name: t("stepOf", { step: one }) }))} onChange={setStep} />}
    >
      <p className="quiet">{t("means")}</p>
      <Suspense fallback={<div className="calibrate__plot" />}>
        <LivePlot glove={glove} finger={finger} thresholds={thresholds} onDrag={(which, to) => move(finger, which, to)} />
      </Suspense>
      <div className="calibrate__fingers">
        {fingers.map((one) => (
          <FingerColumn
            key={one}
            glove={glove}
            finger={one}
            isChosen={one === finger}
            saved={saved[one]}
            thresholds={thresholds[one]}
            step={size}
            top={topOf(saved)}
            onChoose={() => setFinger(one)}
            onMove={(which, to) => move(one, which, to)}
          />
        ))}
      </div>
      {failure !== null && <Problem>{failure}</Problem>}
      <div className="calibrate__acts" data-unsaved={changes !== null || undefined}>
        <Button kind="main" isDisabled={changes === null} onPress={save}>
          {t("save")}
        </Button>
        <Button isDisabled={changes === null} onPress={forget}>
          {t("back")}
        </Button>
        <Button onPress={restore}>{t("restore")}</Button>
        <p role="status">
          {changes !== null ? (
            <State tone="attention">{t("unsaved", { count: Object.keys(changes).length })}</State>
          ) : (
            said !== null && <State tone="ok">{t(`said.${said}`)}</State>
          )}
        </p>
      </div>
    </Card>
  );
}
