/**
 * The places of the page: one for each kind of work, with its pages.
 *
 * A new page is a folder with a component, and a row here; its name is a text of `common:pages`. Each page but the
 * first loads when it is opened.
 */
import { ClipboardCheck, Factory, HardHat, HeartHandshake, House, Workflow } from "lucide-react";
import { lazy, type ComponentType } from "react";
import HomePage from "~/home/HomePage";
import { mayDo } from "~/session/session";

/** What decides which pages are offered. */
export interface Surroundings {
  services: readonly string[];
  hasOwnHealth: boolean;
}

export interface PlacePage {
  name: string;
  path: string;
  /** What may follow in the path, as a pattern of wouter; without it the path is the whole address. */
  below?: string;
  /** The letter after `g` that leads here. */
  key?: string;
  component: ComponentType;
  /** Without it everyone is offered the page. An address that is not offered still opens: its service says why not. */
  isOffered?: (around: Surroundings) => boolean;
  /** Reached by links, not by the navigation. */
  isHidden?: true;
}

export interface Place {
  name: "home" | "work" | "processes" | "cell" | "care" | "admin";
  icon: ComponentType<{ size?: number; "aria-hidden"?: boolean }>;
  pages: readonly PlacePage[];
}

const runs = (service: string) => (around: Surroundings) => around.services.includes(service);

export const PLACES: readonly Place[] = [
  { name: "home", icon: House, pages: [{ name: "start", path: "/", key: "h", component: HomePage }] },
  {
    name: "work",
    icon: HardHat,
    pages: [
      { name: "work", path: "/work", key: "w", component: lazy(() => import("~/work/WorkPage")) },
      { name: "tasks", path: "/work/tasks", key: "t", component: lazy(() => import("~/tasks/TasksPage")) },
    ],
  },
  {
    name: "processes",
    icon: Workflow,
    pages: [
      { name: "processes", path: "/processes", below: "/*?", key: "p", component: lazy(() => import("~/processes/ProcessesPage")) },
      { name: "statistics", path: "/processes/statistics", key: "k", component: lazy(() => import("~/cockpit/CockpitPage")) },
    ],
  },
  {
    name: "cell",
    icon: Factory,
    pages: [
      { name: "overview", path: "/cell", key: "c", component: lazy(() => import("~/cell/OverviewPage")) },
      { name: "robots", path: "/cell/robots", below: "/:name?/:tab?", key: "r", component: lazy(() => import("~/cell/RobotsPage")) },
      { name: "gloves", path: "/cell/gloves", below: "/:name?/:tab?", key: "l", component: lazy(() => import("~/cell/GlovesPage")) },
      { name: "devices", path: "/cell/devices", below: "/:name?", key: "d", component: lazy(() => import("~/devices/DevicesPage")) },
      { name: "ros", path: "/cell/ros", component: lazy(() => import("~/cell/RosPage")), isOffered: runs("ros-bridge") },
      { name: "events", path: "/cell/events", key: "v", component: lazy(() => import("~/cell/EventsPage")) },
    ],
  },
  {
    name: "care",
    icon: HeartHandshake,
    pages: [
      {
        name: "health",
        path: "/care/health",
        key: "b",
        component: lazy(() => import("~/health/HealthPage")),
        isOffered: (around) => runs("human-state")(around) && (mayDo("readHealthData") || around.hasOwnHealth),
      },
      {
        name: "cases",
        path: "/care/cases",
        key: "y",
        component: lazy(() => import("~/cases/CasesPage")),
        isOffered: (around) => runs("assistive-devices")(around) && mayDo("readHealthData"),
      },
      {
        name: "exercises",
        path: "/care/exercises",
        key: "o",
        component: lazy(() => import("~/humanoid/HumanoidPage")),
        isOffered: runs("whole-body-control"),
      },
      { name: "exercisesInVr", path: "/care/exercises/vr", component: lazy(() => import("~/humanoid/vr/VrPage")), isHidden: true },
    ],
  },
  {
    name: "admin",
    icon: ClipboardCheck,
    pages: [
      { name: "people", path: "/admin/people", key: "e", component: lazy(() => import("~/people/PeoplePage")) },
      { name: "services", path: "/admin/services", below: "/:name?", key: "s", component: lazy(() => import("~/cell/ServicesPage")) },
      { name: "alerting", path: "/admin/alerts", component: lazy(() => import("~/alerting/AlertingPage")) },
      { name: "study", path: "/admin/studies", key: "u", component: lazy(() => import("~/study/StudyPage")) },
    ],
  },
];

/** The list behind the drawer of Alerts; it belongs to no place. */
export const ALERTS_PAGE: PlacePage = { name: "alerts", path: "/alerts", key: "a", component: lazy(() => import("~/cell/AlertsPage")) };

/** All pages, those with the longer path first, as a router compares them. */
export const PAGES: readonly PlacePage[] = [...PLACES.flatMap(({ pages }) => pages), ALERTS_PAGE].sort(
  (page, other) => other.path.length - page.path.length,
);

/** The page at a path, and its place; undefined where there is none. */
export function pageAt(path: string): PlacePage | undefined {
  return PAGES.find((page) => path === page.path || (page.path !== "/" && path.startsWith(`${page.path}/`)));
}

export function placeOf(page: PlacePage | undefined): Place | undefined {
  return PLACES.find(({ pages }) => page !== undefined && pages.includes(page));
}

/** The places with the pages that are offered; a place without any is left out. */
export function offeredPlaces(around: Surroundings): Place[] {
  return PLACES.map((place) => ({ ...place, pages: place.pages.filter((page) => page.isHidden !== true && (page.isOffered?.(around) ?? true)) })).filter(
    ({ pages }) => pages.length > 0,
  );
}
