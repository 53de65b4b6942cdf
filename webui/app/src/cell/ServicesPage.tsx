/** The services of the cell, or one of them. */
import { useParams } from "wouter";
import { ListPage } from "./ListPage";
import { ServicePage } from "./services/ServicePage";
import { ServicesPanel } from "./services/ServicesPanel";

export default function ServicesPage() {
  const { name } = useParams();
  return name === undefined ? (
    <ListPage name="services">
      <ServicesPanel />
    </ListPage>
  ) : (
    <ServicePage key={name} name={name} />
  );
}
