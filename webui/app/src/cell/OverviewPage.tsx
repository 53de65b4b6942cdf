import { ListPage } from "./ListPage";
import { DevicesPanel } from "./devices/DevicesPanel";

export default function OverviewPage() {
  return (
    <ListPage name="overview">
      <DevicesPanel />
    </ListPage>
  );
}
