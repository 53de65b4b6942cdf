import { useTranslation } from "react-i18next";
import { Loading } from "~/design/Loading";
import { useTopic } from "~/live/hooks";
import { addresses } from "~/places/addresses";
import { UnknownName } from "~/route/UnknownName";
import { ListPage } from "./ListPage";
import { RosPanel } from "./ros/RosPanel";

export default function RosPage() {
  const { t } = useTranslation("common");
  const services = useTopic("services");
  if (services === undefined) return <Loading isPage />;
  if (!services.some(({ name }) => name === "ros-bridge")) return <UnknownName thing="page" name={t("pages.ros")} list={addresses.cell()} />;
  return (
    <ListPage name="ros">
      <RosPanel />
    </ListPage>
  );
}
