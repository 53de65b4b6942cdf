/** The guided calibration (fist, open hand; ten seconds), and recordings of single gestures. */
import { Hand as HandIcon } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { requestService, errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { SegmentedControl } from "~/design/SegmentedControl";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { Hand, useGestureName } from "~/hand/Hand";
import { GesturePicker } from "~/hand/GesturePicker";
import { useTopicSelector } from "~/live/hooks";
import type { GuideView } from "~/live/messages";

const SERVICE = "gesture-controller";
/** The countdown ends one second before the step; the ring shows that last second. */
const [COUNTDOWN_MS, STILL_MS] = [3000, 1000];

interface Gesture {
  name: string;
  code?: string;
}

export function GuidedCard({ glove }: { glove: string }) {
  const { t } = useTranslation("calibrate");
  const received = useTopicSelector(`glove/${glove}`, (view) => JSON.stringify(view?.calibration ?? null));
  const guide = useMemo(() => JSON.parse(received) as GuideView | null, [received]);
  const isConnected = useTopicSelector(`glove/${glove}`, (view) => view?.connected) === true;
  const isDue = typeof useTopicSelector(`glove/${glove}`, (view) => view?.calibrationNeeded) === "string";
  const [failure, setFailure] = useState<string | null>(null);
  const act = (path: string, method: "POST" | "PUT" | "DELETE", json?: unknown) => {
    setFailure(null);
    requestService(SERVICE, `gloves/${encodeURIComponent(glove)}/${path}`, { method, ...(json === undefined ? {} : { json }) }).catch(
      (error: unknown) => setFailure(errorText(error)),
    );
  };
  const isOnItsWay = guide !== null && guide.outcome === null;
  return (
    <Card title={t("guided.title")} aside={<Reader glove={glove} act={act} />}>
      {isDue && <StatusBadge tone="attention">{t("guided.due")}</StatusBadge>}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {isOnItsWay ? (
        <OnItsWay guide={guide} glove={glove} onStop={() => act("calibration/guide", "DELETE")} />
      ) : (
        <>
          <p className="quiet">{t(isConnected ? "guided.means" : "guided.away")}</p>
          {guide?.phase === "interrupted" ? (
            <StatusBadge tone="attention">{t("guided.interrupted")}</StatusBadge>
          ) : (
            guide?.outcome != null && <Outcome outcome={guide.outcome} />
          )}
          {guide?.gesture != null && guide.outcome?.applied === true && (
            <Learnt glove={glove} onUse={() => act("recognizer", "PUT", { name: "personal" })} />
          )}
          <div className="guided__actions">
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
  const side = useTopicSelector(`glove/${glove}`, (view) => view?.hand) ?? "right";
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
        <Button permission="configure" size="large" onPress={onStop}>
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
      {outcome.problem === null ? <StatusBadge tone="ok">{t("guided.fits")}</StatusBadge> : <ErrorMessage>{outcome.problem}</ErrorMessage>}
      <ul>
        {outcome.sensorWarnings.map(({ finger, why }) => (
          <li key={finger}>
            <StatusBadge tone="attention">{t(`hand:finger.${finger}`)}</StatusBadge> {t(`guided.sensorWarning.${why}`)}
          </li>
        ))}
      </ul>
    </div>
  );
}

/** A sample was recorded, but the recognizer in use (thresholds) does not use samples. */
function Learnt({ glove, onUse }: { glove: string; onUse: () => void }) {
  const { t } = useTranslation("calibrate");
  const name = useTopicSelector(`glove/${glove}`, (view) => view?.recognizer?.name ?? "");
  if (name !== "thresholds") {
    return null;
  }
  return (
    <p className="guided__learnt">
      {t("guided.learnt")} <Button permission="configure" onPress={onUse}>{t("guided.useModel")}</Button>
    </p>
  );
}

/** Records one second of a gesture of this person. */
function Sample({ isDisabled, onShow }: { isDisabled: boolean; onShow: (gesture: string) => void }) {
  const { t } = useTranslation("calibrate");
  const gestures = (useServiceQuery<Gesture[]>(SERVICE, "gestures").value ?? []).filter((gesture) => gesture.code !== undefined);
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
      <Button permission="configure" isDisabled={isDisabled || gesture === ""} onPress={() => onShow(gesture)}>
        {t("guided.show")}
      </Button>
    </div>
  );
}

/** The choice of the recognizer. */
function Reader({ glove, act }: { glove: string; act: (path: string, method: "PUT", json: unknown) => void }) {
  const { t, i18n } = useTranslation("calibrate");
  const names = useServiceQuery<string[]>(SERVICE, "recognizers").value ?? [];
  const name = useTopicSelector(`glove/${glove}`, (view) => view?.recognizer?.name ?? "");
  const missing = useTopicSelector(`glove/${glove}`, (view) => view?.recognizer?.missing ?? null);
  return (
    <span className="guided__reader">
      {missing !== null && <StatusBadge tone="attention">{missing}</StatusBadge>}
      {names.length > 1 && (
        <SegmentedControl
          label={t("guided.reader")}
          value={name}
          options={names.map((reader) => ({ value: reader, name: i18n.exists(`calibrate:guided.readers.${reader}`) ? t(`guided.readers.${reader}`) : reader }))}
          onChange={(name) => act("recognizer", "PUT", { name: name })}
        />
      )}
    </span>
  );
}
