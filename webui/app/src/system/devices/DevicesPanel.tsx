/** Devices: what the context broker knows of each, whatever component wrote it; sorted and searched, however many. */
import { Cpu, SearchX } from "lucide-react";
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import { RelativeTime } from "~/design/RelativeTime";
import { EmptyState } from "~/design/EmptyState";
import { Field } from "~/design/Field";
import { StatusBadge } from "~/design/StatusBadge";
import { deviceTone } from "~/design/states";
import { VirtualTable, type Column, type Sorting } from "~/design/VirtualTable";
import { useFamily } from "~/live/hooks";
import type { DeviceView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { useQueryParameter } from "~/route/queryParameter";
import { Battery } from "../Battery";
import { valueInWords } from "./value";
import "./DevicesPanel.css";

const compared: Record<string, (device: DeviceView) => string | number> = {
  device: (device) => shortName(device.id),
  category: (device) => device.category.join(),
  state: (device) => device.deviceState ?? "",
  battery: (device) => device.batteryLevel ?? 2,
};

export function DevicesPanel() {
  const { t, i18n } = useTranslation(["system", "common"]);
  const devices = useFamily("device");
  const [find, setFind] = useQueryParameter("find");
  const [sort, setSort] = useQueryParameter("sort", "device");
  const sorting: Sorting = { by: sort.replace(/^-/, ""), isDescending: sort.startsWith("-") };
  const lines = useMemo(() => {
    const valueOf = compared[sort.replace(/^-/, "")] ?? ((device: DeviceView) => shortName(device.id));
    const sign = sort.startsWith("-") ? -1 : 1;
    const words = find.toLowerCase().split(/\s+/);
    return devices
      .filter((device) => words.every((word) => `${device.id} ${device.category.join(" ")} ${device.deviceState ?? ""}`.toLowerCase().includes(word)))
      .sort((a, b) => {
        const [one, other] = [valueOf(a), valueOf(b)];
        const order = typeof one === "number" ? one - Number(other) : one.localeCompare(String(other), undefined, { numeric: true });
        return sign * order || (a.id < b.id ? -1 : 1);
      })
      .map((device) => ({ kind: "row", key: device.id, row: device }) as const);
  }, [devices, find, sort]);
  if (devices.length === 0) {
    return <EmptyState icon={<Cpu aria-hidden size={32} />} title={t("device.none.title")}>{t("device.none.means")}</EmptyState>;
  }
  const columns: readonly Column<DeviceView>[] = [
    {
      id: "device", name: t("device.device"), width: "minmax(180px, 2.2fr)", isSortable: true,
      cell: (device) => (
        <>
          <span className="rows__name">{shortName(device.id)}</span>
          <p className="rows__why rows__urn">{device.id}</p>
        </>
      ),
    },
    {
      id: "category", name: t("device.category"), width: "minmax(90px, 1fr)", isSortable: true,
      cell: (device) => device.category.map((one) => t(`device.kind.${one}`, { defaultValue: one })).join(", "),
    },
    {
      id: "state", name: t("device.state"), width: "minmax(140px, 1fr)", isSortable: true,
      cell: (device) =>
        device.deviceState !== null && <StatusBadge tone={deviceTone[device.deviceState]}>{t(`common:deviceState.${device.deviceState}`)}</StatusBadge>,
    },
    {
      id: "battery", name: t("device.battery"), width: "minmax(90px, 0.8fr)", isSortable: true,
      cell: (device) => device.batteryLevel !== null && <Battery level={device.batteryLevel} />,
    },
    { id: "value", name: t("device.value"), width: "minmax(120px, 2fr)", cell: (device) => valueInWords(device.value, i18n.language) },
    { id: "seen", name: t("device.seen"), width: "112px", cell: (device) => device.observedAt !== null && <RelativeTime at={device.observedAt} /> },
  ];
  return (
    <div className="devices">
      <Field label={t("device.find")} value={find} onChange={setFind} type="search" />
      <VirtualTable
        label={t("tab.devices")}
        lines={lines}
        columns={columns}
        rowHeight={66}
        sorting={sorting}
        onSort={({ by, isDescending }) => setSort(`${isDescending ? "-" : ""}${by}`)}
        nameOf={(device) => shortName(device.id)}
      >
        {lines.length === 0 && <EmptyState icon={<SearchX aria-hidden size={32} />} title={t("device.noMatch")} />}
      </VirtualTable>
    </div>
  );
}
