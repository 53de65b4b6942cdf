/** The page of a service: its state, rates and last message, its Alerts, and the documentation of its interface. */
import { useTranslation } from "react-i18next";
import type { Service } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Card } from "~/design/Card";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { healthTone } from "~/design/states";
import { useHasSnapshot, useTopic } from "~/live/hooks";
import { readable } from "~/live/readable";
import { addresses } from "~/places/addresses";
import { UnknownName } from "~/route/UnknownName";
import { ObjectPage } from "../ObjectPage";
import { ObjectAlerts } from "../objects/ObjectAlerts";
import { Rates } from "./ServicesPanel";
import "../objects/ObjectHistory.css";
import "./ServicesPanel.css";

/** The services that the proxy of the page does not forward to: their interface is that of the page itself. */
const OWN = "webui";
const TABS = ["state"] as const;

interface ApiDocument {
  info: { title: string; version: string };
}

export function ServicePage({ name }: { name: string }) {
  const { t, i18n } = useTranslation(["cell", "system", "common"]);
  const services = useTopic("services") ?? [];
  const isLoaded = useHasSnapshot();
  const cell = useTopic("cell");
  const service = services.find((other) => other.name === name);
  // The document of its interface says the version, and whether its documentation can be reached.
  const { value: api } = useServiceQuery<ApiDocument>(name as Service, service === undefined || name === OWN ? null : "openapi.json", { revision: service?.state ?? "" });
  const titleOf = (other: string) => t(`common:services.${other}`, { defaultValue: other });
  if (service === undefined) return isLoaded ? <UnknownName thing="page" name={name} /> : <p className="quiet shell__loading">{t("common:loading")}</p>;
  const version = api?.info.version ?? (name === OWN ? cell?.version : undefined);
  return (
    <ObjectPage
      list={{ name: "services", address: addresses.services() }}
      name={titleOf(name)}
      names={services.map((other) => titleOf(other.name))}
      tab="state"
      tabs={TABS}
      addressOf={(title) => addresses.service(services.find((other) => titleOf(other.name) === title)?.name ?? name)}
    >
      <div className="history">
        <Card title={t("column.state")} aside={<StatusBadge tone={healthTone[service.state]}>{t(`common:health.${service.state}`)}</StatusBadge>}>
          {service.detail !== null && <p>{readable(service.detail)}</p>}
          <dl className="facts">
            <div>
              <dt>{t("system:service.since")}</dt>
              <dd>
                <RelativeTime at={service.since} isStop />
              </dd>
            </div>
            {version !== undefined && (
              <div>
                <dt>{t("services.version")}</dt>
                <dd>{version}</dd>
              </div>
            )}
            {service.url !== null && (
              <div>
                <dt>{t("services.address")}</dt>
                <dd>{service.url}</dd>
              </div>
            )}
            <div>
              <dt>{t("system:service.rates")}</dt>
              <dd>{Object.keys(service.rates).length === 0 ? "–" : <Rates service={service} language={i18n.language} />}</dd>
            </div>
            {service.lastMessage !== null && (
              <div>
                <dt>{t("system:service.last")}</dt>
                <dd>
                  {readable(service.lastMessage.text)}{" "}
                  <span className="quiet small">
                    <RelativeTime at={service.lastMessage.at} isStop />
                  </span>
                </dd>
              </div>
            )}
          </dl>
        </Card>
        <ObjectAlerts entity={null} name={name} />
        <Card title={t("services.docs")}>
          {api === null ? (
            <p className="quiet">{t("services.noDocs")}</p>
          ) : (
            <p>
              <a href={`/api/${name}/docs`} target="_blank" rel="noreferrer">
                {t("services.api")}
              </a>
            </p>
          )}
          <p className="quiet small">{t("services.settings")}</p>
        </Card>
      </div>
    </ObjectPage>
  );
}
