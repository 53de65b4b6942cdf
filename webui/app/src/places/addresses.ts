/** The addresses of the page. A link takes its address from here, so that one that does not exist is no program. */

export const ROBOT_TABS = ["state", "control", "limits", "history", "settings"] as const;
export type RobotTab = (typeof ROBOT_TABS)[number];

export const GLOVE_TABS = ["state", "calibrate", "test", "history"] as const;
export type GloveTab = (typeof GLOVE_TABS)[number];

type Query = Readonly<Record<string, string | undefined>>;

export const addresses = {
  home: () => "/",
  alerts: (query: { alert?: string } = {}) => withQuery("/alerts", query),

  work: (query: { glove?: string } = {}) => withQuery("/work", query),
  tasks: (query: { task?: string; show?: "mine" | "groups" | "free" } = {}) => withQuery("/work/tasks", query),

  processes: (query: { state?: string } = {}) => withQuery("/processes", query),
  process: (id: string) => `/processes/${encodeURIComponent(id)}`,
  statistics: () => "/processes/statistics",

  cell: (query: { find?: string; show?: "attention"; kind?: string } = {}) => withQuery("/cell", query),
  robots: () => "/cell/robots",
  robot: (name: string, tab: RobotTab = "state") => object("/cell/robots", name, tab),
  gloves: () => "/cell/gloves",
  glove: (name: string, tab: GloveTab = "state", query: Query = {}) => withQuery(object("/cell/gloves", name, tab), query),
  devices: (query: { add?: "yes"; name?: string; as?: string | undefined; view?: "board" } = {}) => withQuery("/cell/devices", query),
  device: (name: string, query: { part?: string; values?: string } = {}) => withQuery(`/cell/devices/${encodeURIComponent(name)}`, query),
  sensors: () => withQuery("/cell/devices", { view: "board" }),
  events: (query: { source?: string } = {}) => withQuery("/cell/events", query),
  health: (query: { person?: string } = {}) => withQuery("/care/health", query),
  cases: (query: { case?: string } = {}) => withQuery("/care/cases", query),
  humanoid: () => "/care/exercises",
  humanoidInVr: () => "/care/exercises/vr",
  people: (query: { view?: string; person?: string; user?: string } = {}) => withQuery("/admin/people", query),
  services: () => "/admin/services",
  service: (name: string) => `/admin/services/${encodeURIComponent(name)}`,
  study: (query: { session?: string } = {}) => withQuery("/admin/studies", query),
} as const;

/** The first tab has the address of the object itself. */
function object(list: string, name: string, tab: string): string {
  const path = `${list}/${encodeURIComponent(name)}`;
  return tab === "state" ? path : `${path}/${tab}`;
}

function withQuery(path: string, query: Query): string {
  const parameters = new URLSearchParams(Object.entries(query).filter((entry): entry is [string, string] => entry[1] !== undefined && entry[1] !== ""));
  return parameters.size === 0 ? path : `${path}?${parameters.toString()}`;
}
