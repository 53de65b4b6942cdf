/** Upload: a BPMN file is shown and checked before it is deployed; faults are shown at their elements. */
import { FileCheck2, FileUp } from "lucide-react";
import { lazy, Suspense, useEffect, useMemo, useState } from "react";
import { FileTrigger } from "react-aria-components";
import { useTranslation } from "react-i18next";
import type { DefinitionView, Deployment, DeploymentCheck } from "~/api/generated/task-orchestrator";
import { requestService, errorText, ApiError } from "~/api/http";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { Performer } from "../definition/Activities";
import { marksOfFaults, withPicked } from "../diagram/marks";
import { faultsOf, listedFaults, type BpmnFault } from "./faults";
import { textOf } from "./file";
import "./UploadPanel.css";

const Diagram = lazy(() => import("../diagram/Diagram"));

const TYPES = [".bpmn", ".xml", "application/xml", "text/xml"];

export interface UploadPanelProps {
  file: File | null;
  onFile: (file: File) => void;
  onDeployed: (definition: DefinitionView) => void;
}

interface Looked {
  file: File;
  xml: string;
  check: DeploymentCheck | null;
  faults: BpmnFault[];
  warnings: BpmnFault[];
  failure: string | null;
}

export function UploadPanel({ file, onFile, onDeployed }: UploadPanelProps) {
  const { t } = useTranslation("processes");
  const [looked, setLooked] = useState<Looked | null>(null);

  useEffect(() => {
    if (file === null) return;
    let left = false;
    void look(file).then((seen) => {
      if (!left) setLooked(seen);
    });
    return () => {
      left = true;
    };
  }, [file]);

  const choose = (
    <FileTrigger
      acceptedFileTypes={TYPES}
      onSelect={(files) => {
        const [first] = files ?? [];
        if (first !== undefined) onFile(first);
      }}
    >
      <Button kind={file === null ? "main" : "plain"} icon={<FileUp aria-hidden size={18} />}>
        {t(file === null ? "upload.choose" : "upload.other")}
      </Button>
    </FileTrigger>
  );
  if (file === null) {
    return (
      <EmptyState icon={<FileUp aria-hidden size={40} />} title={t("upload.title")} act={choose}>
        {t("upload.drop")}
      </EmptyState>
    );
  }
  if (looked?.file !== file) return <p className="processes__loading quiet">{t("upload.reading", { file: file.name })}</p>;
  return (
    <div className="upload">
      <header className="upload__head">
        <h1>{file.name}</h1>
        {choose}
        <Verdict looked={looked} onDeployed={onDeployed} />
      </header>
      <Faulted key={`${file.name} ${file.lastModified}`} looked={looked} />
    </div>
  );
}

function Verdict({ looked, onDeployed }: { looked: Looked; onDeployed: (definition: DefinitionView) => void }) {
  const { t } = useTranslation("processes");
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const { check, faults } = looked;
  if (looked.failure !== null) return <ErrorMessage>{t("upload.untried", { why: looked.failure })}</ErrorMessage>;
  if (check === null) return <StatusBadge tone="stop">{t("upload.faulty", { count: faults.length })}</StatusBadge>;
  const concerns = looked.warnings.length + check.allocation.filter((line) => line.warning !== null).length;
  const deploy = () => {
    setBusy(true);
    setFailure(null);
    requestService<Deployment>("task-orchestrator", "definitions", { method: "POST", body: looked.file, type: "application/xml" })
      .then(onDeployed, (error: unknown) => setFailure(errorText(error)))
      .finally(() => setBusy(false));
  };
  return (
    <>
      {check.definitions.length > 1 && <p className="quiet">{t("upload.several", { titles: check.definitions.map(({ title }) => title).join(", ") })}</p>}
      <StatusBadge tone={concerns === 0 ? "ok" : "attention"}>
        {t(!check.created ? "upload.known" : concerns === 0 ? "upload.fine" : "upload.warnedFine", { title: check.title, version: check.version })}
      </StatusBadge>
      {concerns > 0 && <StatusBadge tone="attention">{t("upload.warned", { count: concerns })}</StatusBadge>}
      <Button kind="main" icon={<FileCheck2 aria-hidden size={18} />} isDisabled={busy} onPress={deploy}>
        {t(check.created ? "upload.deploy" : "upload.see", { title: check.title, version: check.version })}
      </Button>
      {failure !== null && <ErrorMessage>{t("upload.untried", { why: failure })}</ErrorMessage>}
    </>
  );
}

function Faulted({ looked }: { looked: Looked }) {
  const { t } = useTranslation("processes");
  const { faults, warnings, check } = looked;
  const allocation = check?.allocation ?? [];
  const hasLists = faults.length + warnings.length + allocation.length > 0;
  const isPlaced = faults.some((fault) => fault.element !== null);
  const [centred, setCentred] = useState<{ element: string; at: number } | null>(null);
  const picked = centred?.element ?? null;
  const marks = useMemo(() => withPicked(marksOfFaults(faults, warnings), picked), [faults, warnings, picked]);
  const show = (element: string) => setCentred({ element, at: Date.now() });
  return (
    <div className={hasLists ? "upload__body upload__body--faulty" : "upload__body"}>
      {hasLists && (
        <div className="upload__lists">
          {faults.length > 0 && (
            <section className="upload__faults" aria-label={t("upload.faults")}>
              <h2>{t("upload.faults")}</h2>
              <FaultList faults={faults} first={1} picked={picked} onPick={show} />
              <p className="quiet small">{t(isPlaced ? "upload.mendAt" : "upload.mend")}</p>
            </section>
          )}
          {warnings.length > 0 && (
            <section className="upload__faults upload__faults--warnings" aria-label={t("upload.warnings")}>
              <h2>{t("upload.warnings")}</h2>
              <p className="quiet small">{t("upload.warningsMean")}</p>
              <FaultList faults={warnings} first={faults.length + 1} picked={picked} onPick={show} />
            </section>
          )}
          {allocation.length > 0 && (
            <section className="upload__allocation" aria-label={t("upload.allocation")}>
              <h2>{t("upload.allocation")}</h2>
              <dl>
                {allocation.map((line) => (
                  <div key={`${line.process} ${line.element}`}>
                    <dt>{line.name === "" ? line.element : line.name}</dt>
                    <dd>
                      <Performer line={line} />
                    </dd>
                  </div>
                ))}
              </dl>
            </section>
          )}
        </div>
      )}
      <div className="upload__diagram">
        <Suspense fallback={<p className="processes__loading quiet">{t("diagram.loading")}</p>}>
          <Diagram xml={looked.xml} label={t("diagram.ofFile", { file: looked.file.name })} marks={marks} centred={centred} />
        </Suspense>
      </div>
    </div>
  );
}

interface FaultListProps {
  faults: readonly BpmnFault[];
  /** The number of the first one. */
  first: number;
  picked: string | null;
  onPick: (element: string) => void;
}

function FaultList({ faults, first, picked, onPick }: FaultListProps) {
  return (
    <ol start={first}>
      {faults.map((fault, nth) => (
        <li key={nth}>
          {fault.element === null ? (
            <Fault fault={fault} number={first + nth} />
          ) : (
            <button type="button" aria-pressed={picked === fault.element} onClick={() => onPick(fault.element ?? "")}>
              <Fault fault={fault} number={first + nth} />
            </button>
          )}
        </li>
      ))}
    </ol>
  );
}

function Fault({ fault, number }: { fault: BpmnFault; number: number }) {
  const { t } = useTranslation("processes");
  const { element, name, line } = fault;
  const where = element === null ? t("upload.wholeFile") : name === null ? element : t("upload.element", { name, id: element });
  return (
    <span className="upload__fault">
      <b aria-hidden>{number}</b>
      <span>
        <span className="upload__where">
          {where}
          {line !== null && ` · ${t("upload.line", { line })}`}
        </span>
        {fault.message}
      </span>
    </span>
  );
}

/** Read a file and have the orchestrator try it; nothing is deployed. */
async function look(file: File): Promise<Looked> {
  const seen = { file, xml: await textOf(file), check: null, faults: [], warnings: [], failure: null };
  try {
    const check = await requestService<DeploymentCheck>("task-orchestrator", "definitions?dry=true", {
      method: "POST",
      body: file,
      type: "application/xml",
    });
    return { ...seen, check, warnings: listedFaults(check.warnings) };
  } catch (error) {
    if (error instanceof ApiError && error.problem.status === 422) {
      return { ...seen, faults: faultsOf(error), warnings: listedFaults(error.problem["warnings"]) };
    }
    return { ...seen, failure: errorText(error) };
  }
}
