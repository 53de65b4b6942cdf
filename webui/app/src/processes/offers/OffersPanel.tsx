/** Offers: definitions that other systems have written to the broker; an engineer accepts or rejects them. */
import { Check, Inbox, X } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { OfferRequest, OfferView } from "~/api/generated/task-orchestrator";
import { requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { localizedText } from "~/i18n/server";
import { MendDialog } from "../incidents/MendDialog";
import { listedFaults } from "../upload/faults";
import { changeText } from "./changes";
import "./OffersPanel.css";

const REFRESH_MS = 5000;
const PATH = "offers?status=open";

type Act = "accept" | "reject";

/** The open offers, read again every few seconds. */
export function useOpenOffers() {
  return useServiceQuery<OfferView[]>("task-orchestrator", PATH, { intervalMs: REFRESH_MS });
}

export function OffersPanel() {
  const { t } = useTranslation("processes");
  const { value: offers, failure, reload } = useOpenOffers();
  const [deciding, setDeciding] = useState<{ offer: OfferView; act: Act } | null>(null);
  const decide = async (offer: OfferView, act: Act, decision: OfferRequest) => {
    try {
      await requestService<OfferView>("task-orchestrator", `offers/${encodeURIComponent(offer.id)}/${act}`, { method: "POST", json: decision });
    } finally {
      reload();
    }
  };
  return (
    <div className="offers">
      <header>
        <h1>{t("offers.title")}</h1>
        <p className="quiet">{t("offers.what")}</p>
      </header>
      {failure !== null && <ErrorMessage>{t("offers.unread", { why: failure })}</ErrorMessage>}
      {offers?.length === 0 && (
        <EmptyState icon={<Inbox aria-hidden size={40} />} title={t("offers.none")}>
          {t("offers.noneHow")}
        </EmptyState>
      )}
      <ul>
        {offers?.map((offer) => (
          <li key={offer.id}>
            <Offer offer={offer} onAct={(act) => setDeciding({ offer, act })} />
          </li>
        ))}
      </ul>
      {deciding !== null && (
        <MendDialog
          key={`${deciding.offer.id} ${deciding.act}`}
          title={t(`offers.${deciding.act}.title`, { name: deciding.offer.name })}
          act={t(`offers.${deciding.act}.act`)}
          kind={deciding.act === "accept" ? "main" : "stop"}
          means={t(deciding.act === "accept" ? `offers.accept.${effectOf(deciding.offer)}` : "offers.reject.means")}
          onClose={() => setDeciding(null)}
          onAct={(decision) => decide(deciding.offer, deciding.act, { by: decision.by, why: decision.why ?? null })}
        />
      )}
    </div>
  );
}

function Offer({ offer, onAct }: { offer: OfferView; onAct: (act: Act) => void }) {
  const { t } = useTranslation("processes");
  const faults = listedFaults(offer.faults);
  const warnings = listedFaults(offer.warnings);
  return (
    <article className="offer" aria-label={offer.name}>
      <h2>{offer.name}</h2>
      <p className="offer__facts">
        <StatusBadge tone={faults.length > 0 ? "stop" : warnings.length > 0 ? "attention" : "neutral"}>{t(`offers.type.${typeOf(offer)}`)}</StatusBadge>
        <span className="quiet small offer__entity">{offer.entity}</span>
        <span className="quiet small">
          <RelativeTime at={offer.foundAt} />
        </span>
      </p>
      {offer.definitions.map(({ name, version, title }) => (
        <p key={name}>{t("offers.becomes", { title, version })}</p>
      ))}
      <Listed title={t("offers.faults")} lines={faults.map((fault) => [fault.name ?? fault.element, fault.message].filter(Boolean).join(": "))} />
      <Listed title={t("offers.warnings")} lines={warnings.map((fault) => [fault.name ?? fault.element, fault.message].filter(Boolean).join(": "))} />
      <Listed title={t("offers.changes")} lines={offer.changes.map((change) => changeText(change, (kind) => t(`offers.change.${kind}`)))} />
      <Listed
        title={t("offers.allocation")}
        lines={offer.allocation.map((line) => {
          const why = localizedText(line, "warning") ?? localizedText(line, "reason") ?? t("offers.people");
          return line.performer === null ? `${line.name}: ${why}` : `${line.name}: ${line.performer} (${why})`;
        })}
      />
      <div className="offer__acts">
        <Button permission="deployProcesses" kind="main" icon={<Check aria-hidden size={18} />} isDisabled={faults.length > 0} onPress={() => onAct("accept")}>
          {t("offers.accept.act")}
        </Button>
        <Button permission="deployProcesses" icon={<X aria-hidden size={18} />} onPress={() => onAct("reject")}>
          {t("offers.reject.act")}
        </Button>
      </div>
    </article>
  );
}

function Listed({ title, lines }: { title: string; lines: readonly string[] }) {
  if (lines.length === 0) return null;
  return (
    <details className="offer__list" open={lines.length <= 8}>
      <summary>{`${title} (${lines.length})`}</summary>
      <ul>
        {lines.map((line, nth) => (
          <li key={nth}>{line}</li>
        ))}
      </ul>
    </details>
  );
}

const TYPES = ["ProcessDefinition", "TaskDefinition", "ResourceSpecification", "Location"] as const;

function typeOf(offer: OfferView): (typeof TYPES)[number] {
  return TYPES.find((type) => type === offer.type) ?? "ProcessDefinition";
}

/** What follows from the acceptance, as the text that says so is called. */
function effectOf(offer: OfferView): "process" | "task" | "resource" {
  if (offer.type === "ProcessDefinition") return "process";
  return offer.type === "TaskDefinition" ? "task" : "resource";
}
