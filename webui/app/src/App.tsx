/** The page of each address. */
import { Suspense, lazy } from "react";
import { useTranslation } from "react-i18next";
import { Link, Redirect, Route, Switch, useLocation, useSearch } from "wouter";
import { RouterProvider } from "react-aria-components";
import { EmptyState } from "~/design/EmptyState";
import { Loading } from "~/design/Loading";
import { useHasSnapshot } from "~/live/hooks";
import { useGloveNames, useRobotNames } from "~/live/names";
import { addresses } from "~/places/addresses";
import { presentAddress } from "~/places/formerAddresses";
import { PAGES } from "~/places/places";
import { ErrorBoundary } from "~/shell/ErrorBoundary";
import { Shell } from "~/shell/Shell";
import { useParticipantMode } from "~/study/participantMode";

const ParticipantFrame = lazy(() => import("~/study/ParticipantFrame"));
const StudyPage = lazy(() => import("~/study/StudyPage"));
const WorkPage = lazy(() => import("~/work/WorkPage"));

export function App() {
  const [path, go] = useLocation();
  const address = `${path}?${useSearch()}`;
  const participant = useParticipantMode();
  if (participant !== null) {
    return (
      <RouterProvider navigate={go}>
        <Suspense fallback={null}>
          <ParticipantFrame mode={participant}>
            <ErrorBoundary key={path} address={address}>{path === addresses.work() ? <WorkPage /> : <StudyPage />}</ErrorBoundary>
          </ParticipantFrame>
        </Suspense>
      </RouterProvider>
    );
  }
  return (
    <RouterProvider navigate={go}>
      <Shell>
        <ErrorBoundary key={path.split("/").slice(1, 3).join("/")} address={address}>
          <Switch>
            {PAGES.map((page) => (
              <Route key={page.path} path={`${page.path}${page.below ?? ""}`} component={page.component} />
            ))}
            <Route component={FormerOrUnknown} />
          </Switch>
        </ErrorBoundary>
      </Shell>
    </RouterProvider>
  );
}

/** An address of a former version leads to the present one; any other is named as unknown. */
function FormerOrUnknown() {
  const { t } = useTranslation("common");
  const [path] = useLocation();
  const search = useSearch();
  const [robot] = useRobotNames();
  const [glove] = useGloveNames();
  const hasSnapshot = useHasSnapshot();
  const to = presentAddress(path, search, { robot, glove });
  if (to === null) return <EmptyState title={t("unknownPage.title")} act={<Link href={addresses.home()}>{t("unknownPage.act")}</Link>} />;
  return hasSnapshot ? <Redirect to={to} replace /> : <Loading isPage />;
}
