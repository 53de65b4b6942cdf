import { ListPage } from "./ListPage";
import { EventsPanel } from "./events/EventsPanel";

export default function EventsPage() {
  return (
    <ListPage name="events">
      <EventsPanel />
    </ListPage>
  );
}
