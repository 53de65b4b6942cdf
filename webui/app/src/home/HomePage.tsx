/** Home: by role, what waits for me, what is wrong, what runs and how the day goes; and the guide until it has been followed. */
import { lazy, Suspense, useSyncExternalStore, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Loading } from "~/design/Loading";
import { useHasSnapshot, useTopicSelector } from "~/live/hooks";
import { useSession } from "~/session/session";
import { DaySection } from "./DaySection";
import { useGuideState } from "./guideState";
import { MySection } from "./MySection";
import { OpenSection, RunningSection } from "./ProcessSections";
import { columnsOf, homeRole, type SectionName } from "./roles";
import { WrongSection } from "./WrongSection";
import "./HomePage.css";

const Guide = lazy(() => import("./Guide"));
const CareSection = lazy(() => import("./CareSections").then(({ CareSection: component }) => ({ default: component })));
const ExercisesSection = lazy(() => import("./CareSections").then(({ ExercisesSection: component }) => ({ default: component })));
const PeopleSection = lazy(() => import("./PeopleSection").then(({ PeopleSection: component }) => ({ default: component })));

const SECTIONS: Readonly<Record<SectionName, (services: readonly string[]) => ReactNode>> = {
  mine: () => <MySection />,
  wrong: () => <WrongSection />,
  running: () => <RunningSection />,
  open: () => <OpenSection />,
  day: () => <DaySection />,
  care: () => <CareSection />,
  exercises: (services) => <ExercisesSection services={services} />,
  people: () => <PeopleSection />,
};

export default function HomePage() {
  const { t } = useTranslation(["home", "common"]);
  const hasSnapshot = useHasSnapshot();
  const { hasAccounts } = useSession();
  const running = useTopicSelector("services", (services) => services?.map(({ name }) => name).join() ?? "");
  const services = running.split(",");
  const isNarrow = useNarrow();
  const guide = useGuideState();
  return (
    <div className="home">
      <h1 className="home__title">{t("common:pages.start")}</h1>
      {hasSnapshot ? (
        <>
          {(guide === "" || guide === "wanted") && (
            <Suspense fallback={null}>
              <Guide services={services} isWanted={guide === "wanted"} />
            </Suspense>
          )}
          <div className="home__board">
            {columnsOf(homeRole(), { services, hasAccounts }, isNarrow).map((names) => (
              <div key={names.join()} className="home__column">
                {names.map((name) => (
                  <Suspense key={name} fallback={<Loading />}>
                    {SECTIONS[name](services)}
                  </Suspense>
                ))}
              </div>
            ))}
          </div>
        </>
      ) : (
        <Loading />
      )}
    </div>
  );
}

/** Below it there is one column. */
const NARROW = "(width < 900px)";

function useNarrow(): boolean {
  return useSyncExternalStore(
    (listener) => {
      const query = matchMedia(NARROW);
      query.addEventListener("change", listener);
      return () => query.removeEventListener("change", listener);
    },
    () => matchMedia(NARROW).matches,
  );
}
