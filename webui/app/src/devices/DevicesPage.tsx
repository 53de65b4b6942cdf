/** The Devices page: a list of the registered robots and devices, and one of them in full. */
import { Cpu, Plus, SearchX } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { Link, useLocation, useParams } from "wouter";
import type { CertificateView, TokenView } from "~/api/generated/device-gateway";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { Loading } from "~/design/Loading";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { useRegisteredDevices } from "~/live/hooks";
import type { RegisteredDeviceView } from "~/live/messages";
import { addresses } from "~/places/addresses";
import { UnknownName } from "~/route/UnknownName";
import { useChoice } from "~/route/choice";
import { useQueryChange, useQueryParameter } from "~/route/queryParameter";
import { matching } from "~/sensors/rooms";
import { mayDo } from "~/session/session";
import { useKeys } from "~/shell/keys";
import { ConditionBadge } from "./ConditionBadge";
import { CertificateDialog } from "./CertificateDialog";
import { DevicePanel } from "./DevicePanel";
import { AddDevice } from "./form/DeviceForm";
import { useUnits } from "./gateway";
import { KindIcon } from "./KindIcon";
import { TokenDialog } from "./TokenDialog";
import { conditionOf, titleOf } from "./values";
import "./DevicesPage.css";

export default function DevicesPage() {
  // Load the texts of all parts with the page: a part that loads them later would suspend it and lose the focus.
  const { t } = useTranslation(["devices", "common", "system", "tasks"]);
  const { devices, isCurrent } = useRegisteredDevices();
  const { units, symbolOf } = useUnits();
  const { name: chosen = "" } = useParams();
  const [, go] = useLocation();
  const [adding] = useChoice("add", ["", "yes"], "");
  const change = useQueryChange();
  const [token, setToken] = useState<TokenView | null>(null);
  const [certificate, setCertificate] = useState<CertificateView | null>(null);
  const mayConfigure = mayDo("configure");
  const isAdding = adding === "yes" && mayConfigure;
  const device = devices?.find(({ name }) => name === chosen) ?? null;
  const add = () => change({ add: "yes" });
  const open = (name: string) => go(name === "" ? addresses.devices() : addresses.device(name));
  useKeys(mayConfigure ? [{ key: "n", does: t("add.act"), act: add }] : []);
  return (
    <div className="devices-page" data-open={isAdding || device !== null || undefined}>
      <aside className="devices-page__list">
        <header className="devices-page__head">
          <h1>{t("title")}</h1>
          {mayConfigure && (
            <Button icon={<Plus aria-hidden size={18} />} onPress={add} isDisabled={isAdding}>
              {t("add.act")}
            </Button>
          )}
        </header>
        {!isCurrent && <ErrorMessage act={<Link href={addresses.services()}>{t("toSystem")}</Link>}>{t("gatewayAway")}</ErrorMessage>}
        {devices === null && <Loading />}
        {devices !== null && devices.length > 0 && (
          <DeviceTable
            devices={devices}
            name={isAdding ? null : chosen}
            onOpen={open}
          />
        )}
      </aside>
      <div className="devices-page__place">
        {isAdding ? (
          <AddDevice
            units={units}
            onClose={() => change({ add: "" })}
            onAdded={(made) => {
              open(made.name);
              setToken(made);
            }}
          />
        ) : device !== null ? (
          <DevicePanel key={device.name} device={device} units={units} symbolOf={symbolOf} onToken={setToken} onCertificate={setCertificate} onClose={() => open("")} />
        ) : chosen !== "" ? (
          devices !== null && <UnknownName thing="device" name={chosen} list={addresses.devices()} />
        ) : devices?.length === 0 && isCurrent ? (
          <EmptyState
            icon={<Cpu aria-hidden size={32} />}
            title={t("none.title")}
            act={
              mayConfigure && (
                <Button kind="main" onPress={add}>
                  {t("add.act")}
                </Button>
              )
            }
          >
            {t("none.means")}
          </EmptyState>
        ) : (
          devices !== null && devices.length > 0 && <EmptyState icon={<Cpu aria-hidden size={32} />} title={t("choose")} />
        )}
      </div>
      <TokenDialog made={token} onClose={() => setToken(null)} />
      <CertificateDialog made={certificate} onClose={() => setCertificate(null)} />
    </div>
  );
}

function DeviceTable({ devices, name, onOpen }: { devices: readonly RegisteredDeviceView[]; name: string | null; onOpen: (name: string) => void }) {
  const { t } = useTranslation("devices");
  const [find, setFind] = useQueryParameter("find");
  const [sorting, setSorting] = useSorting("device");
  const shown = useMemo(() => matching(devices, find, false), [devices, find]);
  const columns: readonly Column<RegisteredDeviceView>[] = useMemo(
    () => [
      {
        id: "device", name: t("list.device"), width: "minmax(0, 1fr)", sortBy: titleOf,
        cell: (device) => (
          <span className="device-name">
            <KindIcon kind={device.kind} />
            <span>
              <strong>{titleOf(device)}</strong>
              <span className="quiet small">{device.title === "" ? t(`kind.${device.kind}`, { defaultValue: device.kind }) : device.name}</span>
            </span>
          </span>
        ),
      },
      { id: "state", name: t("list.state"), width: "auto", sortBy: conditionOf, cell: (device) => <ConditionBadge device={device} /> },
    ],
    [t],
  );
  return (
    <>
      <Field label={t("list.find")} value={find} onChange={setFind} type="search" />
      <DataTable
        label={t("title")}
        rows={shown}
        columns={columns}
        keyOf={(device) => device.name}
        nameOf={titleOf}
        rowHeight={58}
        sorting={sorting}
        onSort={setSorting}
        view={find}
        openKey={name}
        onOpen={(device) => onOpen(device.name)}
        isCompact
      >
        {shown.length === 0 && <EmptyState icon={<SearchX aria-hidden size={32} />} title={t("list.noMatch")} />}
      </DataTable>
    </>
  );
}
