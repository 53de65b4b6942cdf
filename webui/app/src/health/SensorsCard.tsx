/** The sensors of a person: connection, contact, battery, and what is wrong. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { PersonView, SensorChange, SensorStateView } from "~/api/generated/human-state";
import { errorText, requestService } from "~/api/http";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { localizedText } from "~/i18n/server";
import { mayDo } from "~/session/session";
import { Battery } from "~/cell/Battery";
import { SERVICE, sensorFault } from "./health";

const SIMULATED = ["ecg", "respiration", "acceleration", "pressureMap", "heartRate"];

export function SensorsCard({ person, onChange }: { person: PersonView; onChange: () => void }) {
  const { t } = useTranslation("health");
  const [failure, setFailure] = useState<string | null>(null);
  const start = async () => {
    setFailure(null);
    const json: SensorChange = { person: person.person, driver: "simulated", settings: { signals: SIMULATED } };
    try {
      await requestService(SERVICE, `sensors/${encodeURIComponent(`simulated-${person.pseudonym}`)}`, { method: "PUT", json });
      onChange();
    } catch (error) {
      setFailure(errorText(error));
    }
  };
  return (
    <Card title={t("sensors.title")} className="health__sensors">
      {person.sensors.length === 0 ? (
        <EmptyState title={t("sensors.none")} act={mayDo("configure") && <Button onPress={() => void start()}>{t("sensors.simulate")}</Button>}>
          {t("sensors.add")}
        </EmptyState>
      ) : (
        <ul className="health__list">
          {person.sensors.map((sensor) => (
            <Sensor key={sensor.name} sensor={sensor} />
          ))}
        </ul>
      )}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </Card>
  );
}

function Sensor({ sensor }: { sensor: SensorStateView }) {
  const { t } = useTranslation("health");
  const fault = sensorFault(sensor);
  return (
    <li>
      <span>
        {sensor.name} <span className="quiet small">{sensor.driver}</span>
      </span>
      <span className="health__marks">
        {sensor.link === null ? (
          <StatusBadge tone="neutral">{t("sensors.waiting")}</StatusBadge>
        ) : fault === null ? (
          <StatusBadge tone="ok">{t("sensors.link.connected")}</StatusBadge>
        ) : (
          <StatusBadge tone={fault.kind === "fault" || fault.what === "fault" ? "stop" : "attention"}>{t(fault.kind === "link" ? `sensors.link.${fault.what}` : `sensors.fault.${fault.what}`, { defaultValue: fault.what })}</StatusBadge>
        )}
        {sensor.battery !== null && <Battery level={sensor.battery} />}
      </span>
      {sensor.problem !== "" && <span className="quiet small health__problem">{localizedText(sensor, "problem")}</span>}
      {sensor.leftOut.map((signal) => (
        <span key={signal.name} className="quiet small health__problem">
          {t("sensors.leftOut", { name: signal.name, reason: localizedText(signal, "reason") })}
        </span>
      ))}
    </li>
  );
}
