/** The tokens of scripts and devices, with roles of their own; a new one is shown once. */
import { KeyRound, Plus } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { RelativeTime } from "~/design/RelativeTime";
import { Select } from "~/design/Select";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { exactTime } from "~/design/times";
import { useKeys } from "~/shell/keys";
import { issueToken, revokeToken, SERVICE, type TokenView } from "./accounts";
import { GrantForm } from "./GrantForm";
import { useGrantWords } from "./GrantList";
import { grantsOf, NEW_DRAFT } from "./grants";
import { SecretDialog, type Secret } from "./SecretDialog";

const REFRESH_MS = 15_000;
const KINDS = ["script", "device"] as const;
const DAYS = ["30", "90", "365", "0"] as const;

export function TokensView() {
  const { t } = useTranslation("accounts");
  const { value, failure, reload } = useServiceQuery<TokenView[]>(SERVICE, "tokens", { intervalMs: REFRESH_MS });
  const [isIssuing, setIssuing] = useState(false);
  const [revoking, setRevoking] = useState<TokenView | null>(null);
  const [secret, setSecret] = useState<Secret | null>(null);
  const [made, setMade] = useState<string>();
  const [sorting, setSorting] = useSorting("-made", "tokenSort");
  const columns = useColumns(setRevoking);
  useKeys([{ key: "n", does: t("tokens.issue"), act: () => setIssuing(true) }]);
  const issue = (
    <Button kind="main" icon={<Plus aria-hidden size={18} />} onPress={() => setIssuing(true)}>
      {t("tokens.issue")}
    </Button>
  );
  return (
    <section className="accounts__wide" aria-label={t("tokens.title")}>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {value?.length === 0 ? (
        <EmptyState icon={<KeyRound aria-hidden size={32} />} title={t("tokens.none")} act={issue}>
          {t("tokens.noneMeans")}
        </EmptyState>
      ) : (
        <>
          <div className="accounts__bar">{issue}</div>
          <DataTable
            label={t("tokens.title")}
            rows={value ?? []}
            columns={columns}
            keyOf={(token) => token.subject}
            nameOf={(token) => token.name}
            rowHeight={56}
            isLabelled
            sorting={sorting}
            onSort={setSorting}
            made={made}
          />
        </>
      )}
      {isIssuing && <IssueDialog onClose={() => setIssuing(false)} onIssued={(issued, subject) => { setSecret(issued); setMade(subject); reload(); }} />}
      <ConfirmDialog
        isOpen={revoking !== null}
        onClose={() => setRevoking(null)}
        kind="stop"
        title={t("tokens.revokeTitle", { name: revoking?.name ?? "" })}
        act={t("tokens.revoke")}
        onAct={() => revokeToken(revoking?.subject ?? "").finally(reload)}
      >
        <p>{t("tokens.revokeMeans")}</p>
      </ConfirmDialog>
      <SecretDialog secret={secret} onClose={() => setSecret(null)} />
    </section>
  );
}

function useColumns(onRevoke: (token: TokenView) => void): readonly Column<TokenView>[] {
  const { t, i18n } = useTranslation("accounts");
  const words = useGrantWords();
  return useMemo(
    () => [
      {
        id: "name", name: t("tokens.name"), width: "minmax(140px, 1.5fr)", sortBy: ({ name }) => name,
        cell: ({ name, kind }) => (
          <>
            <strong className="cell__name">{name}</strong>
            <p className="cell__detail">{t(`tokens.kinds.${kind}`, { defaultValue: kind })}</p>
          </>
        ),
      },
      { id: "grants", name: t("tokens.grants"), width: "minmax(160px, 2fr)", cell: ({ grants, kind }) => <span>{kind === "service" ? "–" : words(grants)}</span> },
      { id: "made", name: t("tokens.made"), width: "minmax(100px, 1fr)", isDescendingFirst: true, sortBy: ({ createdAt }) => createdAt, cell: ({ createdAt }) => <RelativeTime at={createdAt} /> },
      {
        id: "used", name: t("tokens.used"), width: "minmax(100px, 1fr)", isDescendingFirst: true, sortBy: ({ usedAt }) => usedAt,
        cell: ({ usedAt }) => (usedAt === null ? <span className="quiet">{t("tokens.never")}</span> : <RelativeTime at={usedAt} />),
      },
      {
        id: "expires", name: t("tokens.expires"), width: "minmax(120px, 1.2fr)", sortBy: ({ expiresAt }) => expiresAt,
        cell: ({ expiresAt }) => <span>{expiresAt === null ? t("tokens.noLimit") : exactTime(expiresAt, i18n.language)}</span>,
      },
      {
        id: "revoke", name: "", width: "120px",
        // Tokens of services are made and replaced on the machine itself, by `handover accounts set-up`.
        cell: (token) =>
          token.kind !== "service" && (
            <Button label={t("tokens.revokeOne", { name: token.name })} onPress={() => onRevoke(token)}>
              {t("tokens.revoke")}
            </Button>
          ),
      },
    ],
    [t, i18n.language, words, onRevoke],
  );
}

function IssueDialog({ onClose, onIssued }: { onClose: () => void; onIssued: (secret: Secret, subject: string) => void }) {
  const { t } = useTranslation("accounts");
  const [name, setName] = useState("");
  const [kind, setKind] = useState<(typeof KINDS)[number]>("script");
  const [days, setDays] = useState<(typeof DAYS)[number]>("90");
  const [draft, setDraft] = useState(NEW_DRAFT);
  const grants = grantsOf(draft);
  return (
    <ConfirmDialog
      isOpen
      onClose={onClose}
      title={t("tokens.issueTitle")}
      act={t("tokens.issue")}
      isDisabled={name.trim().length < 2 || grants.length === 0}
      onAct={async () => {
        const { subject, token } = await issueToken({ name: name.trim(), kind, grants, validDays: days === "0" ? null : Number(days) });
        onIssued({ title: t("tokens.secret", { name: name.trim() }), means: t("tokens.secretMeans"), value: token }, subject);
      }}
    >
      <Field label={t("tokens.name")} value={name} onChange={setName} maxLength={64} autoFocus />
      <Select label={t("tokens.kind")} value={kind} options={KINDS.map((value) => ({ value, name: t(`tokens.kinds.${value}`) }))} onChange={(chosen) => setKind(KINDS.find((one) => one === chosen) ?? "script")} />
      <Select label={t("tokens.valid")} value={days} options={DAYS.map((value) => ({ value, name: t(`tokens.days.${value}`) }))} onChange={(chosen) => setDays(DAYS.find((one) => one === chosen) ?? "90")} />
      <GrantForm draft={draft} onChange={setDraft} />
      {kind === "script" && <p className="quiet small">{t("tokens.performer")}</p>}
    </ConfirmDialog>
  );
}
