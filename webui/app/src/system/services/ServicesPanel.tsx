/** Services: one row per service with its health, rates and last message. */
import { Activity } from "lucide-react";
import { useTranslation } from "react-i18next";
import { RelativeTime } from "~/design/RelativeTime";
import { EmptyState } from "~/design/EmptyState";
import { StatusBadge } from "~/design/StatusBadge";
import { healthTone } from "~/design/states";
import { rate } from "~/design/times";
import { useTopic } from "~/live/hooks";
import type { ServiceHealth } from "~/live/messages";
import { Cell, Row, Rows } from "../Rows";
import "./ServicesPanel.css";

export function ServicesPanel() {
  const { t } = useTranslation("system");
  const services = useTopic("services") ?? [];
  if (services.length === 0) {
    return <EmptyState icon={<Activity aria-hidden size={32} />} title={t("service.none.title")}>{t("service.none.means")}</EmptyState>;
  }
  const heads = ["service", "state", "since", "rates", "last"].map((head) => t(`service.${head}`));
  return (
    <Rows label={t("tab.services")} heads={heads} widths={["18%", "24%", "11%", "22%", "25%"]}>
      {services.map((service, place) => (
        <Service key={service.name} service={service} heads={heads} isFirst={place === 0} />
      ))}
    </Rows>
  );
}

function Service({ service, heads, isFirst }: { service: ServiceHealth; heads: readonly string[]; isFirst: boolean }) {
  const { t, i18n } = useTranslation(["system", "common"]);
  const [name = "", state = "", since = "", rates = "", last = ""] = heads;
  const counted = Object.entries(service.rates);
  return (
    <Row isFirst={isFirst}>
      <Cell head={name}>
        <span className="rows__name">{t(`common:services.${service.name}`, { defaultValue: service.name })}</span>
      </Cell>
      <Cell head={state}>
        <StatusBadge tone={healthTone[service.state]}>{t(`common:health.${service.state}`)}</StatusBadge>
        {service.detail !== null && <p className="rows__why">{service.detail}</p>}
      </Cell>
      <Cell head={since}>
        <RelativeTime at={service.since} />
      </Cell>
      <Cell head={rates}>
        {counted.length > 0 && (
          <ul className="services__rates">
            {counted.map(([word, perSecond]) => (
              <li key={word}>
                <span className="services__rate">{rate(perSecond, i18n.language)}</span>
                <span>{t(`service.rate.${word}`, { defaultValue: word })}</span>
              </li>
            ))}
          </ul>
        )}
      </Cell>
      <Cell head={last}>
        {service.lastMessage !== null && (
          <>
            <span className="services__message">{service.lastMessage.text}</span>{" "}
            <span className="quiet small">
              <RelativeTime at={service.lastMessage.at} />
            </span>
          </>
        )}
      </Cell>
    </Row>
  );
}
