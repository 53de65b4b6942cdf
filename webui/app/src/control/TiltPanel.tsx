/** Drive with the tilt of the phone or tablet that shows the page. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import type { Driver } from "./driver";

export function TiltPanel({ driver: { sensor } }: { driver: Driver }) {
  const { t } = useTranslation("control");
  const [state, setState] = useState<"off" | "asks" | "on" | "none">(sensor.tilt === null ? "off" : "on");
  const start = () => {
    setState("asks");
    sensor.start().then(
      (isThere) => setState(isThere ? "on" : "none"),
      () => setState("none"),
    );
  };
  return (
    <>
      <p className="quiet small">{t(state === "on" ? "tilt.on" : "tilt.means")}</p>
      {state === "on" ? (
        <Button
          onPress={() => {
            sensor.stop();
            setState("off");
          }}
        >
          {t("tilt.stop")}
        </Button>
      ) : (
        <Button kind="main" onPress={start} isDisabled={state === "asks"}>
          {t("tilt.start")}
        </Button>
      )}
      {state === "none" && <ErrorMessage>{t("tilt.none")}</ErrorMessage>}
    </>
  );
}
