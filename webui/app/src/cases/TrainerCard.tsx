/** The trainer beside the treadmill: a face that says the advice, the time left, and what the person chooses. */
import { Play, Volume2, VolumeX } from "lucide-react";
import { useEffect, useRef, useState } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { Checkbox } from "~/design/Checkbox";
import { SegmentedControl } from "~/design/SegmentedControl";
import { Select } from "~/design/Select";
import { StatusBadge } from "~/design/StatusBadge";
import { clockTime } from "~/design/times";
import { localizedText } from "~/i18n/server";
import { Face } from "./Face";
import { INTENSITIES, languageOf, minutesText, newWords, ZONES, type Intensity, type Trainer } from "./trainer";

const MINUTES = ["5", "10", "20", "30"] as const;
const TONES = { faster: "accent", keep: "ok", slower: "attention" } as const;

export function TrainerCard({ trainer, isMoving, heartRateBpm, onStart }: { trainer: Trainer; isMoving: boolean; heartRateBpm: number | null; onStart: (options: Record<string, unknown>) => void }) {
  const { t, i18n } = useTranslation("cases");
  const [isLoud, setLoud] = useState(true);
  const isSpeaking = useSpeech(trainer, isLoud);
  const newest = trainer.interventions.at(-1);
  const isInside = heartRateBpm !== null && heartRateBpm >= trainer.zone.lowBpm && heartRateBpm <= trainer.zone.highBpm;
  return (
    <Card
      title={t("trainer.title")}
      className="trainer"
      aside={
        <Button icon={isLoud ? <Volume2 aria-hidden size={18} /> : <VolumeX aria-hidden size={18} />} onPress={() => setLoud(!isLoud)}>
          {t(isLoud ? "trainer.silence" : "trainer.speak")}
        </Button>
      }
    >
      <div className="trainer__stage">
        <Face advice={newest?.advice ?? "keep"} isSpeaking={isSpeaking} />
        <div>
          <p className="trainer__caption" aria-live="polite">{newest === undefined ? t("trainer.welcome") : (localizedText(newest, "text") ?? t("trainer.thinks"))}</p>
          {newest !== undefined && <StatusBadge tone={TONES[newest.advice]}>{t(`trainer.advice.${newest.advice}`)}</StatusBadge>}
          <dl className="cases__values">
            <div>
              <dt className="small quiet">{t("value.timeLeft")}</dt>
              <dd className="trainer__time">{minutesText(trainer.timeLeftS)}</dd>
            </div>
            <div>
              <dt className="small quiet">{t("trainer.zone")}</dt>
              <dd>
                {t("trainer.range", trainer.zone)}
                {heartRateBpm !== null && <span className="small quiet"> · {t(isInside ? "trainer.inside" : heartRateBpm < trainer.zone.lowBpm ? "trainer.below" : "trainer.above")}</span>}
              </dd>
            </div>
          </dl>
        </div>
      </div>
      {!isMoving && <p className="small quiet">{localizedText(trainer, "reason")}</p>}
      {!isMoving && <PlanForm hasModel={trainer.hasModel} language={i18n.language} onStart={onStart} />}
      {trainer.interventions.length > 0 && (
        <ol className="cases__messages small" aria-label={t("trainer.log")}>
          {[...trainer.interventions].reverse().map((each) => (
            <li key={each.at}>
              <span className="quiet">{clockTime(each.at, i18n.language)}</span> {localizedText(each, "text") ?? "…"}
              {each.source === "model" && <span className="quiet"> · {t("trainer.byModel")}</span>}
            </li>
          ))}
        </ol>
      )}
    </Card>
  );
}

function PlanForm({ hasModel, language, onStart }: { hasModel: boolean; language: string; onStart: (options: Record<string, unknown>) => void }) {
  const { t } = useTranslation("cases");
  const [minutes, setMinutes] = useState<string>("10");
  const [intensity, setIntensity] = useState<Intensity>("light");
  const [consents, setConsents] = useState(false);
  return (
    <div className="trainer__plan">
      <Select label={t("trainer.duration")} value={minutes} options={MINUTES.map((value) => ({ value, name: t("trainer.minutes", { minutes: value }) }))} onChange={setMinutes} />
      <SegmentedControl label={t("trainer.intensity.label")} value={intensity} options={INTENSITIES.map((value) => ({ value, name: t(`trainer.intensity.${value}`) }))} onChange={setIntensity} />
      <span className="small quiet">{t("trainer.range", ZONES[intensity])}</span>
      {hasModel && (
        <Checkbox isSelected={consents} onChange={setConsents}>
          {t("trainer.consent")}
        </Checkbox>
      )}
      <Button
        kind="main"
        icon={<Play aria-hidden size={18} />}
        onPress={() => onStart({ durationS: 60 * Number(minutes), intensity, language: language.slice(0, 2), consentsToModel: consents && hasModel })}
      >
        {t("trainer.start")}
      </Button>
    </div>
  );
}

/** Speak new words where the browser can; return whether it speaks. The caption is there in any case. */
function useSpeech(trainer: Trainer, isLoud: boolean): boolean {
  const { i18n } = useTranslation();
  const [isSpeaking, setSpeaking] = useState(false);
  const lastAt = useRef<string | null>(null);
  const newest = trainer.interventions.at(-1);
  const at = newest?.text === undefined ? "" : newest.at;
  useEffect(() => {
    if (lastAt.current === null) {
      lastAt.current = at; // what was said before the page came
      return;
    }
    const words = newWords(trainer.interventions, lastAt.current);
    if (words === null) return;
    lastAt.current = words.at;
    const speech = "speechSynthesis" in window ? window.speechSynthesis : null;
    if (!isLoud || speech === null) return;
    const said = new SpeechSynthesisUtterance(localizedText(words, "text") ?? "");
    said.lang = languageOf(words, trainer, i18n.language);
    said.onstart = () => setSpeaking(true);
    said.onend = said.onerror = () => setSpeaking(false);
    speech.cancel();
    speech.speak(said);
    // One utterance for each intervention, whatever else is rendered meanwhile.
    // eslint-disable-next-line react-hooks/exhaustive-deps
  }, [at]);
  return isSpeaking;
}
