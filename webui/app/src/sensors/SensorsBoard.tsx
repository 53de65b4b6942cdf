/** The Devices page as a board: the rooms of the site and the live values of their devices. */
import { useWindowVirtualizer } from "@tanstack/react-virtual";
import { MapPin, SearchX, Thermometer } from "lucide-react";
import { useLayoutEffect, useMemo, useRef, useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { Loading } from "~/design/Loading";
import { SegmentedControl } from "~/design/SegmentedControl";
import { useUnits, type SymbolOf } from "~/devices/gateway";
import { conditionOf } from "~/devices/values";
import { useConnectionState, useRegisteredDevices } from "~/live/hooks";
import type { RegisteredDeviceView } from "~/live/messages";
import { addresses } from "~/places/addresses";
import { useChoice } from "~/route/choice";
import { useQueryParameter } from "~/route/queryParameter";
import { mayDo } from "~/session/session";
import { linesOf, matching } from "./rooms";
import { SensorCard } from "./SensorCard";
import "./SensorsBoard.css";

const CARD_PX = 380;
const GAP_PX = 16;

/** `head` chooses between the list and the board; `kind` is that of the devices shown, "" for all. */
export default function SensorsBoard({ head, kind }: { head: ReactNode; kind: string }) {
  const { t } = useTranslation(["devices", "system"]);
  const { devices, isCurrent } = useRegisteredDevices();
  const isLinked = useConnectionState() === "open";
  const { symbolOf } = useUnits();
  const [find, setFind] = useQueryParameter("find");
  const [show, setShow] = useChoice("show", ["all", "attention"], "all");
  const ofKind = useMemo(() => (devices ?? []).filter((device) => kind === "" || device.kind === kind), [devices, kind]);
  const shown = useMemo(() => matching(ofKind, find, show === "attention"), [ofKind, find, show]);
  const attention = useMemo(() => ofKind.filter((device) => conditionOf(device) !== "ok").length, [ofKind]);
  return (
    <div className="sensors" data-old={!isLinked || undefined}>
      <header className="sensors__head">
        {head}
        <Field label={t("list.find")} value={find} onChange={setFind} type="search" />
        <SegmentedControl
          label={t("sensors.show")}
          value={show}
          options={[
            { value: "all", name: t("sensors.all", { count: ofKind.length }) },
            { value: "attention", name: t("sensors.attention", { count: attention }) },
          ]}
          onChange={setShow}
        />
      </header>
      {!isCurrent && <ErrorMessage act={<Link href={addresses.services()}>{t("toSystem")}</Link>}>{t("gatewayAway")}</ErrorMessage>}
      {devices === null ? (
        <Loading />
      ) : devices.length === 0 && isCurrent ? (
        <EmptyState icon={<Thermometer aria-hidden size={32} />} title={t("none.title")} act={mayDo("configure") && <Link href={addresses.devices({ add: "yes" })}>{t("add.act")}</Link>}>
          {t("none.means")}
        </EmptyState>
      ) : shown.length === 0 && devices.length > 0 ? (
        <EmptyState icon={<SearchX aria-hidden size={32} />} title={show === "attention" && find === "" ? t("sensors.allWell") : t("list.noMatch")} />
      ) : (
        <Rooms devices={shown} symbolOf={symbolOf} />
      )}
    </div>
  );
}

function Rooms({ devices, symbolOf }: { devices: readonly RegisteredDeviceView[]; symbolOf: SymbolOf }) {
  const { t } = useTranslation("devices");
  const frame = useRef<HTMLDivElement>(null);
  const [{ columns, top }, setLayout] = useState({ columns: 1, top: 0 });
  useLayoutEffect(() => {
    const host = frame.current;
    if (host === null) return;
    const measure = () => {
      const next = { columns: Math.max(1, Math.floor((host.clientWidth + GAP_PX) / (CARD_PX + GAP_PX))), top: Math.round(host.getBoundingClientRect().top + scrollY) };
      setLayout((before) => (before.columns === next.columns && before.top === next.top ? before : next));
    };
    measure();
    const resized = new ResizeObserver(measure);
    resized.observe(host);
    return () => resized.disconnect();
  }, []);
  const lines = useMemo(() => linesOf(devices, columns), [devices, columns]);
  const virtualizer = useWindowVirtualizer({
    count: lines.length,
    estimateSize: (index) => (lines[index]?.kind === "room" ? 48 : 260),
    getItemKey: (index) => lines[index]?.key ?? index,
    overscan: 3,
    scrollMargin: top,
  });
  return (
    <div ref={frame} className="sensors__rooms" style={{ height: virtualizer.getTotalSize() }}>
      {virtualizer.getVirtualItems().map((item) => {
        const line = lines[item.index];
        if (line === undefined) return null;
        return (
          <div key={item.key} ref={virtualizer.measureElement} data-index={item.index} className="sensors__line" style={{ transform: `translateY(${item.start - top}px)` }}>
            {line.kind === "room" ? (
              <h2 className="sensors__room">
                <MapPin aria-hidden size={20} /> {line.room ?? t("sensors.noRoom")} <span className="quiet">{line.count}</span>
              </h2>
            ) : (
              <div className="sensors__cards" style={{ gridTemplateColumns: `repeat(${columns}, minmax(0, 1fr))` }}>
                {line.devices.map((device) => (
                  <SensorCard key={device.name} device={device} symbolOf={symbolOf} />
                ))}
              </div>
            )}
          </div>
        );
      })}
    </div>
  );
}
