/** Recordings of the humanoid: start, stop, replay, download, deletion; and the controls of a replay. */
import { Circle, Download, Pause, Play, Square, Trash2, Undo2 } from "lucide-react";
import { useState, useSyncExternalStore } from "react";
import { useTranslation } from "react-i18next";
import type { RecordingView } from "~/api/generated/whole-body-control";
import { requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Slider } from "~/control/Slider";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { number } from "~/design/numbers";
import { StatusBadge } from "~/design/StatusBadge";
import { clockTime, span } from "~/design/times";
import { mayDo } from "~/session/session";
import { SERVICE } from "./humanoid";
import type { Replay } from "./replay";
import { useAct } from "./useAct";

const EVERY_MS = 3000;
const MEGABYTE = 1e6;

export function RecordingsCard({ onReplay }: { onReplay: (recording: RecordingView) => void }) {
  const { t, i18n } = useTranslation("humanoid");
  const { value, failure, reload } = useServiceQuery<RecordingView[]>(SERVICE, "recordings", { intervalMs: EVERY_MS });
  const { failure: fault, isBusy, act } = useAct(reload);
  const [label, setLabel] = useState("");
  const [asked, setAsked] = useState<RecordingView | null>(null);
  const recordings = value ?? [];
  const mayRecord = mayDo("conductStudies");
  const isRunning = recordings.some(({ state }) => state === "running");
  const nameOf = ({ label: given }: RecordingView) => (given === "" ? t("recordings.untitled") : given);
  return (
    <Card title={t("recordings.title")}>
      {mayRecord && !isRunning && (
        <div className="humanoid__acts">
          <Field label={t("recordings.label")} value={label} onChange={setLabel} maxLength={200} />
          <Button icon={<Circle aria-hidden size={18} />} isDisabled={isBusy} onPress={() => void act("recordings", { label: label.trim() }).then((isDone) => isDone && setLabel(""))}>
            {t("recordings.start")}
          </Button>
        </div>
      )}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {fault !== null && <ErrorMessage>{fault}</ErrorMessage>}
      {value !== null && recordings.length === 0 && <p className="quiet">{t("recordings.none")}</p>}
      <ul className="humanoid-recordings">
        {recordings.map((each) => (
          <li key={each.id}>
            <span>
              <strong>{nameOf(each)}</strong> <span className="quiet small">{t("recordings.by", { time: clockTime(each.started, i18n.language), by: each.startedBy })}</span>
            </span>
            {each.state === "running" ? (
              <>
                <StatusBadge tone="stop">{t("recordings.running")}</StatusBadge>
                {mayRecord && <Button icon={<Square aria-hidden size={18} />} isDisabled={isBusy} onPress={() => void act(`recordings/${each.id}/stop`)}>{t("recordings.stop")}</Button>}
              </>
            ) : (
              <>
                <span className="quiet small">
                  {t("recordings.size", { span: span(each.durationS ?? 0, i18n.language), size: number(each.size / MEGABYTE, i18n.language, { maximumFractionDigits: 1 }) })}
                </span>
                <Button icon={<Play aria-hidden size={18} />} onPress={() => onReplay(each)}>{t("recordings.replay")}</Button>
                <a className="humanoid-recordings__file" href={`/api/${SERVICE}/recordings/${each.id}`} download title={each.sha256 === null ? undefined : `SHA-256 ${each.sha256}`}>
                  <Download aria-hidden size={18} />
                  {t("recordings.download")}
                </a>
                {mayRecord && <Button icon={<Trash2 aria-hidden size={18} />} onPress={() => setAsked(each)}>{t("recordings.delete")}</Button>}
              </>
            )}
          </li>
        ))}
      </ul>
      {asked !== null && (
        <ConfirmDialog
          isOpen
          onClose={() => setAsked(null)}
          title={t("recordings.deleteAsk", { name: nameOf(asked) })}
          act={t("recordings.delete")}
          kind="stop"
          onAct={async () => {
            await requestService(SERVICE, `recordings/${asked.id}`, { method: "DELETE" });
            reload();
          }}
        >
          <p>{t("recordings.deleteMeans")}</p>
        </ConfirmDialog>
      )}
    </Card>
  );
}

/** Below the picture while a recording is shown in place of the robot. */
export function ReplayBar({ replay, name, failure, onEnd }: { replay: Replay; name: string; failure: string | null; onEnd: () => void }) {
  const { t, i18n } = useTranslation("humanoid");
  const { positionS, durationS, isPlaying } = useSyncExternalStore(replay.subscribe, replay.snapshot);
  return (
    <section className="humanoid-replay" aria-label={t("recordings.replayOf", { name })}>
      <StatusBadge tone="attention">{t("recordings.replayOf", { name })}</StatusBadge>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <Slider
        label={t("recordings.position")}
        value={positionS}
        min={0}
        max={Math.max(durationS, 0.1)}
        step={0.1}
        text={t("recordings.at", { at: number(positionS, i18n.language, { maximumFractionDigits: 1 }), of: number(durationS, i18n.language, { maximumFractionDigits: 1 }) })}
        onChange={(atS) => replay.seek(atS)}
      />
      <div className="humanoid__acts">
        <Button icon={isPlaying ? <Pause aria-hidden size={18} /> : <Play aria-hidden size={18} />} onPress={() => replay.play(!isPlaying)}>
          {t(isPlaying ? "recordings.pause" : "recordings.play")}
        </Button>
        <Button kind="main" icon={<Undo2 aria-hidden size={18} />} onPress={onEnd}>{t("recordings.live")}</Button>
      </div>
    </section>
  );
}
