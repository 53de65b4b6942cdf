import { AlertsPanel } from "~/alerts/list/AlertsPanel";
import { ListPage } from "./ListPage";

export default function AlertsPage() {
  return (
    <ListPage name="alerts">
      <AlertsPanel />
    </ListPage>
  );
}
