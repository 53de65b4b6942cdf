/** Processes: what can run, what runs and what has run, for those who set a cell up or look for a cause. */
import { ArrowLeft, FileUp, Workflow } from "lucide-react";
import { useState } from "react";
import { DropZone } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { useLocation } from "wouter";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import type { DefinitionView } from "~/api/generated/task-orchestrator";
import { UnknownName } from "~/route/UnknownName";
import { useKeys } from "~/shell/keys";
import { pathOf, placeOf, type Place } from "./address";
import { DefinitionPanel } from "./definition/DefinitionPanel";
import { ProcessList } from "./list/ProcessList";
import { OffersPanel, useOpenOffers } from "./offers/OffersPanel";
import { ProcessPanel } from "./process/ProcessPanel";
import { StartDialog } from "./start/StartDialog";
import { UploadPanel } from "./upload/UploadPanel";
import "./ProcessesPage.css";

interface Starting {
  definition: DefinitionView;
  version: number | null;
}

export default function ProcessesPage() {
  const { t } = useTranslation(["processes", "common"]);
  const [path, go] = useLocation();
  const place = placeOf(path);
  const [starting, setStarting] = useState<Starting | null>(null);
  const [file, setFile] = useState<File | null>(null);
  const { value: offers } = useOpenOffers();
  const open = (to: Place) => go(pathOf(to));
  const look = (one: File) => {
    setFile(one);
    open({ kind: "upload" });
  };
  const upload = () => {
    setFile(null);
    open({ kind: "upload" });
  };
  useKeys([
    { key: "f", does: t("keys.find"), act: () => document.querySelector<HTMLInputElement>(".process-list input")?.focus() },
    { key: "n", does: t("keys.upload"), act: upload },
    { key: "i", does: t("keys.incident"), act: () => document.querySelector<HTMLElement>(".incident__acts button")?.focus() },
  ]);
  return (
    <DropZone
      className="processes"
      data-open={place.kind === "nothing" ? undefined : true}
      aria-label={t("upload.dropHere")}
      getDropOperation={(types) => (types.has("application/json") ? "cancel" : "copy")}
      onDrop={(event) => {
        const dropped = event.items.find((item) => item.kind === "file");
        if (dropped?.kind === "file") void dropped.getFile().then(look);
      }}
    >
      <ProcessList
        place={place}
        offers={offers?.length ?? 0}
        onStart={(definition) => setStarting({ definition, version: null })}
        onUpload={upload}
        onOffers={() => open({ kind: "offers" })}
      />
      <div className="processes__place">
        {place.kind !== "nothing" && (
          <div className="processes__back">
            <Button kind="quiet" icon={<ArrowLeft aria-hidden size={18} />} onPress={() => open({ kind: "nothing" })}>
              {t("back")}
            </Button>
          </div>
        )}
        {place.kind === "unknown" && <UnknownName thing="page" name={place.path} />}
        {place.kind === "process" && <ProcessPanel key={place.id} id={place.id} />}
        {place.kind === "definition" && (
          <DefinitionPanel
            key={place.name}
            name={place.name}
            onStart={(definition, version) => setStarting({ definition, version })}
            onDeleted={() => open({ kind: "nothing" })}
          />
        )}
        {place.kind === "offers" && <OffersPanel />}
        {place.kind === "upload" && (
          <UploadPanel
            file={file}
            onFile={setFile}
            onDeployed={(definition) => {
              setFile(null);
              open({ kind: "definition", name: definition.name });
            }}
          />
        )}
        {(place.kind === "nothing" || (place.kind === "upload" && file === null)) && (
          <h1 className="visually-hidden">{t("common:pages.processes")}</h1>
        )}
        {place.kind === "nothing" && (
          <EmptyState
            icon={<Workflow aria-hidden size={40} />}
            title={t("nothing.title")}
            act={
              <Button icon={<FileUp aria-hidden size={18} />} onPress={upload}>
                {t("list.upload")}
              </Button>
            }
          >
            {t("nothing.what")}
          </EmptyState>
        )}
      </div>
      {starting !== null && (
        <StartDialog
          {...starting}
          onClose={() => setStarting(null)}
          onStarted={(process) => open({ kind: "process", id: process.id })}
        />
      )}
    </DropZone>
  );
}
