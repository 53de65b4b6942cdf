import { ListPage } from "./ListPage";
import { RosPanel } from "./ros/RosPanel";

export default function RosPage() {
  return (
    <ListPage name="ros">
      <RosPanel />
    </ListPage>
  );
}
