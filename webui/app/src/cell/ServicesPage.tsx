import { ListPage } from "./ListPage";
import { ServicesPanel } from "./services/ServicesPanel";

export default function ServicesPage() {
  return (
    <ListPage name="services">
      <ServicesPanel />
    </ListPage>
  );
}
