/** The pages and their paths. Each page but the first loads when it is opened. */
import { lazy, Suspense } from "react";
import { useTranslation } from "react-i18next";
import { Link, Route, Switch, useLocation, useSearch } from "wouter";
import { RouterProvider } from "react-aria-components";
import { EmptyState } from "~/design/EmptyState";
import { Shell } from "~/shell/Shell";
import { ErrorBoundary } from "~/shell/ErrorBoundary";
import StartPage from "~/start/StartPage";
import { useParticipantMode } from "~/study/participantMode";

const WorkPage = lazy(() => import("~/work/WorkPage"));
const ProcessesPage = lazy(() => import("~/processes/ProcessesPage"));
const CockpitPage = lazy(() => import("~/cockpit/CockpitPage"));
const TasksPage = lazy(() => import("~/tasks/TasksPage"));
const SystemPage = lazy(() => import("~/system/SystemPage"));
const PeoplePage = lazy(() => import("~/people/PeoplePage"));
const HealthPage = lazy(() => import("~/health/HealthPage"));
const CasesPage = lazy(() => import("~/cases/CasesPage"));
const HumanoidPage = lazy(() => import("~/humanoid/HumanoidPage"));
const VrPage = lazy(() => import("~/humanoid/vr/VrPage"));
const DevicesPage = lazy(() => import("~/devices/DevicesPage"));
const AlertingPage = lazy(() => import("~/alerting/AlertingPage"));
const SensorsPage = lazy(() => import("~/sensors/SensorsPage"));
const ControlPage = lazy(() => import("~/control/ControlPage"));
const CalibratePage = lazy(() => import("~/calibrate/CalibratePage"));
const TestPage = lazy(() => import("~/test/TestPage"));
const ParticipantFrame = lazy(() => import("~/study/ParticipantFrame"));
const StudyPage = lazy(() => import("~/study/StudyPage"));

export function App() {
  const [path, go] = useLocation();
  const address = `${path}?${useSearch()}`;
  const participant = useParticipantMode();
  if (participant !== null) {
    return (
      <RouterProvider navigate={go}>
        <Suspense fallback={null}>
          <ParticipantFrame mode={participant}>
            <ErrorBoundary key={path} address={address}>{path === "/work" ? <WorkPage /> : <StudyPage />}</ErrorBoundary>
          </ParticipantFrame>
        </Suspense>
      </RouterProvider>
    );
  }
  return (
    <RouterProvider navigate={go}>
      <Shell>
        <ErrorBoundary key={path.split("/")[1]} address={address}>
          <Switch>
            <Route path="/" component={StartPage} />
            <Route path="/work" component={WorkPage} />
            <Route path="/processes/*?" component={ProcessesPage} />
            <Route path="/cockpit" component={CockpitPage} />
            <Route path="/tasks" component={TasksPage} />
            <Route path="/system" component={SystemPage} />
            <Route path="/people" component={PeoplePage} />
            <Route path="/sensors" component={SensorsPage} />
            <Route path="/health" component={HealthPage} />
            <Route path="/cases" component={CasesPage} />
            <Route path="/humanoid" component={HumanoidPage} />
            <Route path="/humanoid/vr" component={VrPage} />
            <Route path="/devices" component={DevicesPage} />
            <Route path="/alerting" component={AlertingPage} />
            <Route path="/control" component={ControlPage} />
            <Route path="/calibrate" component={CalibratePage} />
            <Route path="/test" component={TestPage} />
            <Route path="/study" component={StudyPage} />
            <Route component={UnknownPage} />
          </Switch>
        </ErrorBoundary>
      </Shell>
    </RouterProvider>
  );
}

function UnknownPage() {
  const { t } = useTranslation("common");
  return <EmptyState title={t("unknownPage.title")} act={<Link href="/">{t("unknownPage.act")}</Link>} />;
}
