/** The calibration of a glove: the thresholds of each finger over the live signal, and the guided calibration. */
import { lazy, Suspense, useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { requestService, errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { SegmentedControl } from "~/design/SegmentedControl";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { fingers } from "~/hand/geometry";
import { useTopicSelector } from "~/live/hooks";
import { shortName } from "~/live/urn";
import { useChoice } from "~/route/choice";
import { MayNot } from "~/design/MayNot";
import { changesOf, moved, steps, topOf, type Bound, type Step, type Thresholds } from "./draft";
import { FingerColumn } from "./FingerColumn";
import { GuidedCard } from "./GuidedCard";
import "./Calibration.css";

const LivePlot = lazy(() => import("./LivePlot"));

export default function Calibration({ glove }: { glove: string }) {
  return (
    <div className="calibrate">
      <Wearer glove={glove} />
      <div className="calibrate__ways">
        <GuidedCard glove={glove} />
        <ByHand glove={glove} />
      </div>
    </div>
  );
}

function Wearer({ glove }: { glove: string }) {
  const { t } = useTranslation("calibrate");
  const person = useTopicSelector(`glove/${glove}`, (view) => view?.person ?? null);
  const isConnected = useTopicSelector(`glove/${glove}`, (view) => view?.connected) === true;
  return (
    <p className="calibrate__wearer">
      {isConnected ? <StatusBadge tone="ok">{t("connected")}</StatusBadge> : <StatusBadge tone="attention">{t("away")}</StatusBadge>}
      <span className="quiet">{person === null ? t("nobody") : t("worn", { person: shortName(person) })}</span>
    </p>
  );
}

/** Manual thresholds: a draft that applies once it is saved. */
function ByHand({ glove }: { glove: string }) {
  const { t } = useTranslation(["calibrate", "hand"]);
  const received = useTopicSelector(`glove/${glove}`, (view) => (view === undefined ? "" : JSON.stringify(view.thresholds)));
  const saved = useMemo(() => (received === "" ? null : (JSON.parse(received) as Thresholds)), [received]);
  const [draft, setDraft] = useState<Thresholds | null>(null);
  const [step, setStep] = useChoice<Step>("step", steps, "25");
  const [finger, setFinger] = useChoice("finger", fingers, "thumb");
  const [failure, setFailure] = useState<string | null>(null);
  const [notice, setNotice] = useState<"saved" | "restored" | null>(null);
  const size = Number(step);
  const thresholds = draft ?? saved;
  const changes = saved !== null && draft !== null ? changesOf(saved, draft) : null;

  const move = (of: (typeof fingers)[number], which: Bound, to: number) => {
    if (thresholds === null) return;
    setNotice(null);
    setDraft(moved(thresholds, of, which, to));
  };
  const forget = () => {
    setDraft(null);
    setFailure(null);
  };
  const act = async (path: string, method: "PUT" | "POST", words: "saved" | "restored", json?: unknown) => {
    setFailure(null);
    try {
      await requestService("gesture-controller", `gloves/${encodeURIComponent(glove)}/${path}`, { method, ...(json === undefined ? {} : { json }) });
      setDraft(null);
      setNotice(words);
    } catch (error) {
      setFailure(errorText(error));
    }
  };
  const save = () => {
    if (changes !== null) void act("thresholds", "PUT", "saved", changes);
  };
  const restore = () => void act("thresholds/restore", "POST", "restored");
  if (saved === null || thresholds === null) return null;

  return (
    <Card
      title={t("byHand")}
      aside={<SegmentedControl<Step> label={t("step")} value={step} options={steps.map((value) => ({ value, name: t("stepOf", { step: value }) }))} onChange={setStep} />}
    >
      <p className="quiet">{t("means")}</p>
      <Suspense fallback={<div className="calibrate__plot" />}>
        <LivePlot glove={glove} finger={finger} thresholds={thresholds} onDrag={(which, to) => move(finger, which, to)} />
      </Suspense>
      <div className="calibrate__fingers">
        {fingers.map((each) => (
          <FingerColumn
            key={each}
            glove={glove}
            finger={each}
            isChosen={each === finger}
            saved={saved[each]}
            thresholds={thresholds[each]}
            step={size}
            top={topOf(saved)}
            onChoose={() => setFinger(each)}
            onMove={(which, to) => move(each, which, to)}
          />
        ))}
      </div>
      <MayNot permission="configure" />
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <div className="calibrate__actions" data-unsaved={changes !== null || undefined}>
        <Button permission="configure" kind="main" isDisabled={changes === null} onPress={save}>
          {t("save")}
        </Button>
        <Button permission="configure" isDisabled={changes === null} onPress={forget}>
          {t("back")}
        </Button>
        <Button permission="configure" onPress={restore}>{t("restore")}</Button>
        <p role="status">
          {changes !== null ? (
            <StatusBadge tone="attention">{t("unsaved", { count: Object.keys(changes).length })}</StatusBadge>
          ) : (
            notice !== null && <StatusBadge tone="ok">{t(`notice.${notice}`)}</StatusBadge>
          )}
        </p>
      </div>
    </Card>
  );
}
