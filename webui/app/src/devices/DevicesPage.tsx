/** The Devices page: the registered robots and devices as a list or as a board of their values, and one of them in full. */
import { Cpu, Plus, SearchX } from "lucide-react";
import { lazy, useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { Link, useLocation, useParams } from "wouter";
import type { CertificateView, TokenView } from "~/api/generated/device-gateway";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { Loading } from "~/design/Loading";
import { SegmentedControl } from "~/design/SegmentedControl";
import { Select } from "~/design/Select";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { useRegisteredDevices } from "~/live/hooks";
import type { RegisteredDeviceView } from "~/live/messages";
import { useSampledFamily } from "~/live/sampled";
import { shortName } from "~/live/urn";
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
import { OtherDevicePanel } from "./OtherDevicePanel";
import { TokenDialog } from "./TokenDialog";
import { conditionOf, titleOf } from "./values";
import "./DevicesPage.css";

const SensorsBoard = lazy(() => import("~/sensors/SensorsBoard"));

const VIEWS = ["list", "board"] as const;
const NONE: readonly RegisteredDeviceView[] = [];

export default function DevicesPage() {
  // Load the texts of all parts with the page: a part that loads them later would suspend it and lose the focus.
  const { t } = useTranslation(["devices", "common", "system", "tasks", "cell"]);
  const { devices, isCurrent } = useRegisteredDevices();
  const { units, symbolOf } = useUnits();
  const { name: chosen = "" } = useParams();
  const [, go] = useLocation();
  const [adding] = useChoice("add", ["", "yes"], "");
  const [newName] = useQueryParameter("name");
  const [newKind] = useQueryParameter("as");
  const change = useQueryChange();
  const [token, setToken] = useState<TokenView | null>(null);
  const [certificate, setCertificate] = useState<CertificateView | null>(null);
  const mayConfigure = mayDo("configure");
  const [view, setView] = useChoice("view", VIEWS, "list");
  const [kind, setKind] = useQueryParameter("kind");
  const isAdding = adding === "yes" && mayConfigure;
  const device = devices?.find(({ name }) => name === chosen) ?? null;
  const entities = useSampledFamily("device");
  const other = chosen === "" ? undefined : entities.find(({ id }) => id === chosen || shortName(id) === chosen);
  const add = () => change({ add: "yes" });
  const open = (name: string) => go(name === "" ? addresses.devices() : addresses.device(name));
  useKeys(mayConfigure ? [{ key: "n", does: t("add.act"), act: add }] : []);
  const head = (
    <header className="devices-page__head">
      <h1>{t("title")}</h1>
      <SegmentedControl label={t("cell:devices.view")} value={view} options={VIEWS.map((value) => ({ value, name: t(`cell:devices.${value}`) }))} onChange={setView} />
      <KindFilter devices={devices ?? NONE} kind={kind} onChange={setKind} />
      {mayConfigure && (
        <Button icon={<Plus aria-hidden size={18} />} onPress={add} isDisabled={isAdding}>
          {t("add.act")}
        </Button>
      )}
    </header>
  );
  if (view === "board" && chosen === "" && !isAdding) return <SensorsBoard head={head} kind={kind} />;
  return (
    <div className="devices-page" data-open={isAdding || device !== null || other !== undefined || undefined}>
      <aside className="devices-page__list">
        {head}
        {!isCurrent && <ErrorMessage act={<Link href={addresses.services()}>{t("toSystem")}</Link>}>{t("gatewayAway")}</ErrorMessage>}
        {devices === null && <Loading />}
        {devices !== null && devices.length > 0 && (
          <DeviceTable
            devices={devices}
            kind={kind}
            name={isAdding ? null : chosen}
            onOpen={open}
          />
        )}
      </aside>
      <div className="devices-page__place">
        {isAdding ? (
          <AddDevice
            units={units}
            found={{ name: newName, kind: newKind }}
            onClose={() => change({ add: "", name: "", as: "" })}
            onAdded={(made) => {
              open(made.name);
              setToken(made);
            }}
          />
        ) : device !== null ? (
          <DevicePanel key={device.name} device={device} units={units} symbolOf={symbolOf} onToken={setToken} onCertificate={setCertificate} onClose={() => open("")} />
        ) : chosen !== "" ? (
          devices !== null && (other === undefined ? <UnknownName thing="device" name={chosen} list={addresses.devices()} /> : <OtherDevicePanel key={other.id} device={other} />)
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

/** A choice of the kinds that there are. */
function KindFilter({ devices, kind, onChange }: { devices: readonly RegisteredDeviceView[]; kind: string; onChange: (kind: string) => void }) {
  const { t } = useTranslation(["devices", "cell"]);
  const kinds = useMemo(() => [...new Set(devices.map((device) => device.kind))].sort(), [devices]);
  if (kinds.length < 2 && kind === "") return null;
  const options = [{ value: "", name: t("cell:allKinds") }, ...kinds.map((value) => ({ value, name: t(`kind.${value}`, { defaultValue: value }) }))];
  return <Select label={t("cell:kind")} value={kind} options={options} onChange={onChange} />;
}

function DeviceTable({ devices, kind, name, onOpen }: { devices: readonly RegisteredDeviceView[]; kind: string; name: string | null; onOpen: (name: string) => void }) {
  const { t } = useTranslation("devices");
  const [find, setFind] = useQueryParameter("find");
  const [sorting, setSorting] = useSorting("device");
  const shown = useMemo(() => matching(devices, find, false).filter((device) => kind === "" || device.kind === kind), [devices, find, kind]);
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
        view={`${kind} ${find}`}
        openKey={name}
        onOpen={(device) => onOpen(device.name)}
        isCompact
      >
        {shown.length === 0 && <EmptyState icon={<SearchX aria-hidden size={32} />} title={t("list.noMatch")} />}
      </DataTable>
    </>
  );
}
