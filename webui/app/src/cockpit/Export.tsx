/** A button that stores a table or an event log of the orchestrator as a file. */
import { Download } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { download } from "~/api/download";
import { errorText, requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";

export interface ExportProps {
  path: string;
  name: string;
  format?: "csv" | "xes";
}

export function Export({ path, name, format = "csv" }: ExportProps) {
  const { t } = useTranslation("cockpit");
  const [failure, setFailure] = useState<string | null>(null);
  const [busy, setBusy] = useState(false);
  const label = format.toUpperCase();
  const store = () => {
    setBusy(true);
    setFailure(null);
    requestService<string>("task-orchestrator", `${path}${path.endsWith("?") ? "" : "&"}format=${format}`)
      .then(
        // The byte order mark, which spreadsheets need, is lost when a browser reads the text.
        (text) => download(`${name}.${format}`, format === "csv" ? "text/csv" : "application/xml", format === "csv" ? `\uFEFF${text.replace(/^\uFEFF/, "")}` : text),
        (error: unknown) => setFailure(errorText(error)),
      )
      .finally(() => setBusy(false));
  };
  return (
    <span className="cockpit__export">
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <Button kind="quiet" icon={<Download aria-hidden size={16} />} isDisabled={busy} aria-label={t("export", { name: t(`file.${name}`), format: label })} onPress={store}>
        {label}
      </Button>
    </span>
  );
}
