/** Guided: a fist, the open hand, ten seconds; then, for who wants it sharper, a second of any gesture. */
import { Hand as HandIcon } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { callService, describe } from "~/api/http";
import { useAsked } from "~/api/useAsked";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { Choice } from "~/design/Choice";
import { Problem } from "~/design/Problem";
import { State } from "~/design/State";
import { Hand, useGestureName } from "~/hand/Hand";
import { GesturePicker } from "~/hand/GesturePicker";
import { usePick } from "~/live/hooks";
import type { GuideView } from "~/live/messages";

const SERVICE = "gesture-controller";
/** The countdown is as long as its last whole second is read; the still second is the ring's. */
const [COUNTDOWN_MS, STILL_MS] = [3000, 1000];

interface Gesture {
  name: string;
  code?: string;
}

export function GuidedCard({ glove }: { glove: string }) {
  const { t } = useTranslation("calibrate");
  const told = usePick(`glove/${glove}`, (view) => JSON.stringify(view?.calibration ?? null));
  const guide = useMemo(() => JSON.parse(told) as GuideView | null, [told]);
  const isConnected = usePick(`glove/${glove}`, (view) => view?.connected) === true;
  const isDue = typeof usePick(`glove/${glove}`, (view) => view?.calibrationNeeded) === "string";
  const [failure, setFailure] = useState<string | null>(null);
  const act = (path: string, method: "POST" | "PUT" | "DELETE", json?: unknown) => {
    setFailure(null);
    callService(SERVICE, `gloves/${encodeURIComponent(glove)}/${path}`, { method, ...(json === undefined ? {} : { json }) }).catch(
      (error: unknown) => setFailure(describe(error)),
    );
  };
  const isOnItsWay = guide !== null && guide.outcome === null;
  return (
    <Card title={t("guided.title")} aside={<Reader glove={glove} act={act} />}>
      {isDue && <State tone="attention">{t("guided.due")}</State>}
      {failure !== null && <Problem>{failure}</Problem>}
      {isOnItsWay ? (
        <OnItsWay guide={guide} glove={glove} onStop={() => act("calibration/guide", "DELETE")} />
      ) : (
        <>
          <p className="quiet">{t(isConnected ? "guided.means" : "guided.away")}</p>
          {guide?.phase === "interrupted" ? (
            <State tone="attention">{t("guided.interrupted")}</State>
          ) : (
            guide?.outcome != null && <Outcome outcome={guide.outcome} />
          )}
          {guide?.gesture != null && guide.outcome?.applied === true && (
            <Learnt glove={glove} onUse={() => act("recognizer", "PUT", { name: "personal" })} />
          )}
          <div className="guided__acts">
            <Button kind="main" size="large" icon={<HandIcon aria-hidden size={28} />} isDisabled={!isConnected} onPress={() => act("calibration/guide", "POST", {})}>
              {t("guided.act")}
            </Button>
            <Sample isDisabled={!isConnected} onShow={(gesture) => act("calibration/guide", "POST", { gesture })} />
          </div>
          <p className="quiet">{t("guided.readersMean")}</p>
        </>
      )}
    </Card>
  );
}

function OnItsWay({ guide, glove, onStop }: { guide: GuideView; glove: string; onStop: () => void }) {
  const { t } = useTranslation(["calibrate", "hand"]);
  const gestureName = useGestureName();
  const side = usePick(`glove/${glove}`, (view) => view?.hand) ?? "right";
  const isCounting = guide.phase === "countdown";
  const share = 1 - guide.remainingMs / (isCounting ? COUNTDOWN_MS : STILL_MS);
  const fingers = guide.restless.map((finger) => t(`hand:finger.${finger}`)).join(", ");
  return (
    <div className="guided">
      <Hand states={guide.code} side={side} size="240px" />
      <div className="guided__words">
        <p className="guided__ask" role="status">
          {t(`guided.ask.${guide.step}`, { gesture: gestureName(guide.gesture ?? "") })}
        </p>
        <p className="guided__how">
          {isCounting ? t("guided.soon", { count: Math.ceil(guide.remainingMs / 1000) }) : fingers === "" ? t("guided.still") : t("guided.restless", { fingers })}
        </p>
        <div className="guided__bar" data-phase={guide.phase} aria-hidden>
          <span style={{ width: `${Math.min(Math.max(share, 0), 1) * 100}%` }} />
        </div>
        <Button size="large" onPress={onStop}>
          {t("guided.stop")}
        </Button>
      </div>
    </div>
  );
}

function Outcome({ outcome }: { outcome: NonNullable<GuideView["outcome"]> }) {
  const { t } = useTranslation(["calibrate", "hand"]);
  return (
    <div className="guided__outcome">
      {outcome.problem === null ? <State tone="ok">{t("guided.fits")}</State> : <Problem>{outcome.problem}</Problem>}
      <ul>
        {outcome.doubts.map(({ finger, why }) => (
          <li key={finger}>
            <State tone="attention">{t(`hand:finger.${finger}`)}</State> {t(`guided.doubt.${why}`)}
          </li>
        ))}
      </ul>
    </div>
  );
}

/** A sample was taken, but thresholds read the hand: they learn nothing from it. */
function Learnt({ glove, onUse }: { glove: string; onUse: () => void }) {
  const { t } = useTranslation("calibrate");
  const name = usePick(`glove/${glove}`, (view) => view?.recognizer?.name ?? "");
  if (name !== "thresholds") {
    return null;
  }
  return (
    <p className="guided__learnt">
      {t("guided.learnt")} <Button onPress={onUse}>{t("guided.useModel")}</Button>
    </p>
  );
}

/** A second of any gesture: what a person's own way of making it looks like. */
function Sample({ isDisabled, onShow }: { isDisabled: boolean; onShow: (gesture: string) => void }) {
  const { t } = useTranslation("calibrate");
  const gestures = (useAsked<Gesture[]>(SERVICE, "gestures").value ?? []).filter((one) => one.code !== undefined);
  const [chosen, choose] = useState("");
  const gesture = chosen || (gestures[0]?.name ?? "");
  return (
    <div className="guided__sample">
      <GesturePicker
        label={t("guided.sharpen")}
        value={gesture}
        options={gestures.map(({ name, code }) => ({ value: name, hands: [{ code: code ?? "", side: "right" as const }] }))}
        onChange={choose}
      />
      <Button isDisabled={isDisabled || gesture === ""} onPress={() => onShow(gesture)}>
        {t("guided.show")}
      </Button>
    </div>
  );
}

/** What reads the hand. */
function Reader({ glove, act }: { glove: string; act: (path: string, method: "PUT", json: unknown) => void }) {
  const { t, i18n } = useTranslation("calibrate");
  const names = useAsked<string[]>(SERVICE, "recognizers").value ?? [];
  const name = usePick(`glove/${glove}`, (view) => view?.recognizer?.name ?? "");
  const missing = usePick(`glove/${glove}`, (view) => view?.recognizer?.missing ?? null);
  return (
    <span className="guided__reader">
      {missing !== null && <State tone="attention">{missing}</State>}
      {names.length > 1 && (
        <Choice
          label={t("guided.reader")}
          value={name}
          options={names.map((one) => ({ value: one, name: i18n.exists(`calibrate:guided.readers.${one}`) ? t(`guided.readers.${one}`) : one }))}
          onChange={(wanted) => act("recognizer", "PUT", { name: wanted })}
        />
      )}
    </span>
  );
}
