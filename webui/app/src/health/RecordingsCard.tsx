/** The recordings of a person: start, markers, stop, download, deletion. */
import { Circle, Download, Flag, Square, Trash2 } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { MarkerGiven, PersonView, RecordingStart, RecordingView } from "~/api/generated/human-state";
import { errorText, requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { number } from "~/design/numbers";
import { StatusBadge } from "~/design/StatusBadge";
import { clockTime, duration } from "~/design/times";
import { useNow } from "~/live/clock";
import { mayDo } from "~/session/session";
import { useWithName } from "~/shell/userName";
import { pathOf, SERVICE } from "./health";

const EVERY_MS = 5000;
const MEGABYTE = 1e6;
const FORMATS = { mcap: "file", xdf: "xdf", fhir: "bundle" } as const;
type Format = keyof typeof FORMATS;

export function RecordingsCard({ person, onChange }: { person: PersonView; onChange: () => void }) {
  const { t } = useTranslation("health");
  const path = `${pathOf(person.person)}/recordings`;
  const { value, failure, reload } = useServiceQuery<RecordingView[]>(SERVICE, path, { intervalMs: EVERY_MS });
  const [fault, setFault] = useState<string | null>(null);
  const mayRecord = mayDo("conductStudies");
  const act = async (request: () => Promise<unknown>) => {
    setFault(null);
    try {
      await request();
      reload();
      onChange();
    } catch (error) {
      setFault(errorText(error));
    }
  };
  const recordings = value ?? [];
  const isRunning = recordings.some(({ state }) => state === "running");
  return (
    <Card title={t("recordings.title")} className="health__recordings">
      {!person.purposes.includes("recording") && <p className="quiet">{t("recordings.off")}</p>}
      {person.purposes.includes("recording") && mayRecord && !isRunning && <Start path={path} act={act} />}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {fault !== null && <ErrorMessage>{fault}</ErrorMessage>}
      {value !== null && recordings.length === 0 && <p className="quiet">{t("recordings.none")}</p>}
      <ul className="health__list">
        {recordings.map((each) => (
          <Recording key={each.id} recording={each} path={`${path}/${each.id}`} mayRecord={mayRecord} act={act} />
        ))}
      </ul>
    </Card>
  );
}

type Act = (request: () => Promise<unknown>) => Promise<void>;

function Start({ path, act }: { path: string; act: Act }) {
  const { t } = useTranslation("health");
  const { withName, question } = useWithName();
  const [label, setLabel] = useState("");
  const start = () => {
    void withName((startedBy) =>
      act(async () => {
        const json: RecordingStart = { label: label.trim(), startedBy };
        await requestService(SERVICE, path, { method: "POST", json });
        setLabel("");
      }),
    );
  };
  return (
    <div className="health__acts">
      <Field label={t("recordings.label")} value={label} onChange={setLabel} maxLength={200} />
      <Button kind="main" icon={<Circle aria-hidden size={18} />} onPress={start}>
        {t("recordings.start")}
      </Button>
      {question}
    </div>
  );
}

function Recording({ recording, path, mayRecord, act }: { recording: RecordingView; path: string; mayRecord: boolean; act: Act }) {
  const { t, i18n } = useTranslation("health");
  const [isAsked, setAsked] = useState(false);
  const name = recording.label === "" ? t("recordings.untitled") : recording.label;
  return (
    <li className="health__recording">
      <span>
        <strong>{name}</strong> <span className="quiet small">{t("recordings.by", { time: clockTime(recording.started, i18n.language), by: recording.startedBy })}</span>
      </span>
      <State recording={recording} />
      {recording.state === "running" && mayRecord && <Running path={path} act={act} />}
      {recording.state === "ended" && <Ended recording={recording} path={path} />}
      {mayRecord && recording.state !== "running" && (
        <Button icon={<Trash2 aria-hidden size={18} />} onPress={() => setAsked(true)}>
          {t("recordings.delete")}
        </Button>
      )}
      {isAsked && (
        <ConfirmDialog
          isOpen
          onClose={() => setAsked(false)}
          title={t("recordings.deleteAsk", { name })}
          act={t("recordings.delete")}
          kind="stop"
          onAct={() => act(() => requestService(SERVICE, path, { method: "DELETE" }))}
        >
          <p>{t("recordings.deleteMeans")}</p>
        </ConfirmDialog>
      )}
    </li>
  );
}

function State({ recording }: { recording: RecordingView }) {
  const { t, i18n } = useTranslation("health");
  const nowMs = useNow();
  const lasted = duration((recording.ended === null ? nowMs : Date.parse(recording.ended)) - Date.parse(recording.started), i18n.language);
  if (recording.state === "running") return <StatusBadge tone="attention">{`${t("recordings.running")} · ${lasted}`}</StatusBadge>;
  if (recording.state === "interrupted") return <StatusBadge tone="stop">{t("recordings.interrupted")}</StatusBadge>;
  return <StatusBadge tone="neutral">{`${lasted} · ${t(`recordings.reason.${recording.endReason ?? "stopped"}`, { defaultValue: recording.endReason ?? "" })}`}</StatusBadge>;
}

function Running({ path, act }: { path: string; act: Act }) {
  const { t } = useTranslation("health");
  const [name, setName] = useState("");
  const [marked, setMarked] = useState<string | null>(null);
  const mark = () =>
    void act(async () => {
      const json: MarkerGiven = { name: name.trim() };
      await requestService(SERVICE, `${path}/markers`, { method: "POST", json });
      setMarked(name.trim());
      setName("");
    });
  return (
    <div className="health__acts">
      <Field label={t("recordings.marker")} value={name} onChange={setName} maxLength={64} />
      <Button icon={<Flag aria-hidden size={18} />} isDisabled={name.trim() === ""} onPress={mark}>
        {t("recordings.mark")}
      </Button>
      <Button kind="main" icon={<Square aria-hidden size={18} />} onPress={() => void act(() => requestService(SERVICE, `${path}/stop`, { method: "POST" }))}>
        {t("recordings.stop")}
      </Button>
      <p className="quiet small" role="status">
        {marked === null ? t("recordings.tasks") : t("recordings.marked", { name: marked })}
      </p>
    </div>
  );
}

function Ended({ recording, path }: { recording: RecordingView; path: string }) {
  const { t, i18n } = useTranslation("health");
  const megabytes = number((recording.size ?? 0) / MEGABYTE, i18n.language, { maximumFractionDigits: 1 });
  const lasted = duration(Date.parse(recording.ended ?? recording.started) - Date.parse(recording.started), i18n.language);
  return (
    <>
      <span className="quiet small">
        {t("recordings.size", { duration: lasted, size: megabytes, messages: number(recording.messages ?? 0, i18n.language) })} {t("recordings.deletedAfter", { time: clockTime(recording.deletedAfter, i18n.language) })}
      </span>
      {recording.sha256 !== null && <code className="small health__digest">{t("recordings.sha256", { digest: recording.sha256 })}</code>}
      <span className="health__marks">
        {(Object.keys(FORMATS) as Format[]).map((format) => (
          <a key={format} className="health__download" href={`/api/${SERVICE}/${path}/${FORMATS[format]}`} download>
            <Download aria-hidden size={16} /> {t(`recordings.format.${format}`)}
          </a>
        ))}
      </span>
    </>
  );
}
