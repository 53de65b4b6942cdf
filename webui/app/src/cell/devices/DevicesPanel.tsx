/** Devices: a table of all Device entities of the context broker, with search and sorting. */
import { Cpu, SearchX } from "lucide-react";
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import { RelativeTime } from "~/design/RelativeTime";
import { EmptyState } from "~/design/EmptyState";
import { Field } from "~/design/Field";
import { StatusBadge } from "~/design/StatusBadge";
import { deviceTone } from "~/design/states";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { useFamily } from "~/live/hooks";
import type { DeviceView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { useQueryParameter } from "~/route/queryParameter";
import { Battery } from "../Battery";
import { valueInWords } from "./value";
import "./DevicesPanel.css";

export function DevicesPanel() {
  const { t } = useTranslation(["system", "common"]);
  const devices = useFamily("device");
  const [find, setFind] = useQueryParameter("find");
  const [sorting, setSorting] = useSorting("device");
  const matching = useMemo(() => {
    const words = find.toLowerCase().split(/\s+/);
    return devices.filter((device) => words.every((word) => `${device.id} ${device.category.join(" ")} ${device.deviceState ?? ""}`.toLowerCase().includes(word)));
  }, [devices, find]);
  const columns = useColumns();
  if (devices.length === 0) {
    return <EmptyState icon={<Cpu aria-hidden size={32} />} title={t("device.none.title")}>{t("device.none.means")}</EmptyState>;
  }
  return (
    <div className="devices">
      <Field label={t("device.find")} value={find} onChange={setFind} type="search" />
      <DataTable
        label={t("tab.devices")}
        rows={matching}
        columns={columns}
        keyOf={idOf}
        nameOf={nameOf}
        rowHeight={66}
        sorting={sorting}
        onSort={setSorting}
        view={find}
      >
        {matching.length === 0 && <EmptyState icon={<SearchX aria-hidden size={32} />} title={t("device.noMatch")} />}
      </DataTable>
    </div>
  );
}

function idOf(device: DeviceView): string {
  return device.id;
}

function nameOf(device: DeviceView): string {
  return shortName(device.id);
}

function useColumns(): readonly Column<DeviceView>[] {
  const { t, i18n } = useTranslation(["system", "common"]);
  return useMemo(() => {
    const kindOf = (device: DeviceView) => device.category.map((category) => t(`device.kind.${category}`, { defaultValue: category })).join(", ");
    return [
      {
        id: "device", name: t("device.device"), width: "minmax(170px, 2fr)", sortBy: nameOf,
        cell: (device) => (
          <>
            <span className="cell__name">{nameOf(device)}</span>
            <p className="cell__detail">{device.id}</p>
          </>
        ),
      },
      { id: "category", name: t("device.category"), width: "minmax(90px, 1fr)", sortBy: kindOf, cell: kindOf },
      {
        id: "state", name: t("device.state"), width: "minmax(140px, 1fr)", sortBy: (device) => device.deviceState,
        cell: (device) =>
          device.deviceState !== null && <StatusBadge tone={deviceTone[device.deviceState]}>{t(`common:deviceState.${device.deviceState}`)}</StatusBadge>,
      },
      {
        id: "battery", name: t("device.battery"), width: "minmax(172px, 0.9fr)", sortBy: (device) => device.batteryLevel,
        cell: (device) => device.batteryLevel !== null && <Battery level={device.batteryLevel} />,
      },
      { id: "value", name: t("device.value"), width: "minmax(100px, 1.6fr)", cell: (device) => valueInWords(device.value, i18n.language) },
      {
        id: "seen", name: t("device.seen"), width: "112px", isDescendingFirst: true,
        sortBy: (device) => (device.observedAt === null ? null : Date.parse(device.observedAt)),
        cell: (device) => device.observedAt !== null && <RelativeTime at={device.observedAt} />,
      },
    ];
  }, [t, i18n.language]);
}
