/** Services: one row per service with its health, rates and last message. */
import { Activity } from "lucide-react";
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import { Link, useLocation } from "wouter";
import { RelativeTime } from "~/design/RelativeTime";
import { EmptyState } from "~/design/EmptyState";
import { StatusBadge } from "~/design/StatusBadge";
import { healthTone } from "~/design/states";
import { rate } from "~/design/times";
import { useTopic } from "~/live/hooks";
import { readable } from "~/live/readable";
import type { ServiceHealth } from "~/live/messages";
import { addresses } from "~/places/addresses";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import "./ServicesPanel.css";

const BY_HEALTH: readonly ServiceHealth["state"][] = ["down", "degraded", "up"];
const NONE: readonly ServiceHealth[] = [];

export function ServicesPanel() {
  const { t } = useTranslation(["system", "common"]);
  const services = useTopic("services") ?? NONE;
  const [sorting, setSorting] = useSorting("");
  const [, go] = useLocation();
  const columns = useColumns();
  if (services.length === 0) {
    return <EmptyState icon={<Activity aria-hidden size={32} />} title={t("service.none.title")}>{t("service.none.means")}</EmptyState>;
  }
  return (
    <DataTable
      label={t("tab.services")}
      rows={services}
      columns={columns}
      keyOf={(service) => service.name}
      nameOf={(service) => t(`common:services.${service.name}`, { defaultValue: service.name })}
      rowHeight={72}
      isLabelled
      sorting={sorting}
      onSort={setSorting}
      onOpen={(service) => go(addresses.service(service.name))}
    />
  );
}

function useColumns(): readonly Column<ServiceHealth>[] {
  const { t, i18n } = useTranslation(["system", "common"]);
  return useMemo(() => {
    const nameOf = (service: ServiceHealth) => t(`common:services.${service.name}`, { defaultValue: service.name });
    return [
      { id: "service", name: t("service.service"), width: "minmax(150px, 1.8fr)", sortBy: nameOf, cell: (service) => <Link href={addresses.service(service.name)} tabIndex={-1} className="cell__name">{nameOf(service)}</Link> },
      {
        id: "state", name: t("service.state"), width: "minmax(190px, 2.4fr)", sortBy: (service) => BY_HEALTH.indexOf(service.state),
        cell: (service) => (
          <>
            <StatusBadge tone={healthTone[service.state]}>{t(`common:health.${service.state}`)}</StatusBadge>
            {service.detail !== null && <p className="cell__detail">{readable(service.detail)}</p>}
          </>
        ),
      },
      {
        id: "since", name: t("service.since"), width: "minmax(104px, 1.1fr)", isDescendingFirst: true,
        sortBy: (service) => Date.parse(service.since),
        cell: (service) => <RelativeTime at={service.since} />,
      },
      { id: "rates", name: t("service.rates"), width: "minmax(180px, 2.2fr)", cell: (service) => <Rates service={service} language={i18n.language} /> },
      {
        id: "last", name: t("service.last"), width: "minmax(180px, 2.5fr)", isDescendingFirst: true,
        sortBy: (service) => (service.lastMessage === null ? null : Date.parse(service.lastMessage.at)),
        cell: ({ lastMessage }) =>
          lastMessage !== null && (
            <>
              <span className="services__message">{readable(lastMessage.text)}</span>{" "}
              <span className="quiet small">
                <RelativeTime at={lastMessage.at} />
              </span>
            </>
          ),
      },
    ];
  }, [t, i18n.language]);
}

export function Rates({ service, language }: { service: ServiceHealth; language: string }) {
  const { t } = useTranslation("system");
  const rates = Object.entries(service.rates);
  if (rates.length === 0) return null;
  return (
    <ul className="services__rates">
      {rates.map(([name, perSecond]) => (
        <li key={name}>
          <span className="services__rate">{rate(perSecond, language)}</span>
          <span>{t(`service.rate.${name}`, { defaultValue: name })}</span>
        </li>
      ))}
    </ul>
  );
}
