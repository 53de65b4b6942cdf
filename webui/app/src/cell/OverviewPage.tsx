import { ListPage } from "./ListPage";
import { Overview } from "./overview/Overview";

export default function OverviewPage() {
  return (
    <ListPage name="overview">
      <Overview />
    </ListPage>
  );
}
