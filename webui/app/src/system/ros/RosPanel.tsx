/** ROS: one row a rule of the bridge, how much it passes on, what last, and what kept it from doing so. */
import { Waypoints } from "lucide-react";
import { useTranslation } from "react-i18next";
import { BreakableText } from "~/design/BreakableText";
import { RelativeTime } from "~/design/RelativeTime";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge, type Tone } from "~/design/StatusBadge";
import { rate } from "~/design/times";
import { Cell, Row, Rows } from "../Rows";
import { oneLine, standing, useRules, type RuleView, type Standing } from "./rules";
import "./RosPanel.css";

const tones: Record<Standing, Tone> = { off: "neutral", silent: "attention", works: "ok", waits: "accent" };

export function RosPanel() {
  const { t } = useTranslation("system");
  const { rules, failure, turn } = useRules();
  const heads = ["rule", "state", "rates", "value", "error", "act"].map((head) => t(`ros.${head}`));
  return (
    <>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {rules?.length === 0 && (
        <EmptyState icon={<Waypoints aria-hidden size={32} />} title={t("ros.none.title")}>
          {t("ros.none.means")}
        </EmptyState>
      )}
      {rules !== null && rules.length > 0 && (
        <Rows label={t("tab.ros")} heads={heads} widths={["20%", "15%", "18%", "17%", "17%", "13%"]}>
          {rules.map((rule, place) => (
            <Rule key={rule.name} rule={rule} heads={heads} isFirst={place === 0} turn={turn} />
          ))}
        </Rows>
      )}
    </>
  );
}

interface RuleProps {
  rule: RuleView;
  heads: readonly string[];
  isFirst: boolean;
  turn: (rule: RuleView, on: boolean) => void;
}

function Rule({ rule, heads, isFirst, turn }: RuleProps) {
  const { t, i18n } = useTranslation("system");
  const [name = "", state = "", rates = "", value = "", error = "", act = ""] = heads;
  const stands = standing(rule);
  const trouble = rule.lastError ?? rule.lastUnreadable ?? null;
  return (
    <Row isFirst={isFirst}>
      <Cell head={name}>
        <span className="rows__name">{rule.name}</span>
        <p className="rows__why">
          <BreakableText of={rule.from} /> → <BreakableText of={rule.to} />
        </p>
      </Cell>
      <Cell head={state}>
        <StatusBadge tone={tones[stands]}>{t(`ros.stands.${stands}`)}</StatusBadge>
      </Cell>
      <Cell head={rates}>
        <ul className="ros__rates">
          <li>
            <span className="ros__rate">{rate(rule.receivedPerS, i18n.language)}</span>
            <span>{t("ros.received")}</span>
          </li>
          <li>
            <span className="ros__rate">{rate(rule.forwardedPerS, i18n.language)}</span>
            <span>{t("ros.forwarded")}</span>
          </li>
        </ul>
        {rule.dropped > 0 && <p className="rows__why">{t("ros.dropped", { count: rule.dropped })}</p>}
      </Cell>
      <Cell head={value}>
        <code className="ros__value">{oneLine(rule.lastValue)}</code>
      </Cell>
      <Cell head={error}>
        {trouble !== null && (
          <>
            <span className="small">{oneLine(trouble, 240)}</span>{" "}
            {rule.lastErrorAt !== null && (
              <span className="quiet small">
                <RelativeTime at={rule.lastErrorAt} />
              </span>
            )}
          </>
        )}
      </Cell>
      <Cell head={act}>
        <Button label={t(rule.enabled ? "ros.turnOff" : "ros.turnOn", { rule: rule.name })} onPress={() => turn(rule, !rule.enabled)}>
          {t(rule.enabled ? "ros.off" : "ros.on")}
        </Button>
      </Cell>
    </Row>
  );
}
