/** The types and requests of the page: anomaly rules of the device gateway, channels and routes of the alert router. */
import type { AlertExample, ChannelView, MessageView, Route, RouteAnswer, RouteView, TestResult } from "~/api/generated/alert-router";
import type { AnomalyView, Rule, RuleTest, RuleTestView, RuleView } from "~/api/generated/device-gateway";
import { requestService } from "~/api/http";

export type { AnomalyView, ChannelView, MessageView, Route, RouteView, Rule, RuleTestView, RuleView };
export type Channel = ChannelView["channel"];

export const GATEWAY = "device-gateway";
export const ROUTER = "alert-router";
export const SEVERITIES = ["informational", "low", "medium", "high", "critical"] as const;

const of = (list: string, name: string) => `${list}/${encodeURIComponent(name)}`;

export const saveRule = (name: string, json: Rule): Promise<RuleView> => requestService(GATEWAY, of("rules", name), { method: "PUT", json });
export const deleteRule = (name: string): Promise<unknown> => requestService(GATEWAY, of("rules", name), { method: "DELETE" });
export const testRule = (json: RuleTest): Promise<RuleTestView> => requestService(GATEWAY, "rules/test", { method: "POST", json });

export const saveRoute = (name: string, json: Route): Promise<RouteView> => requestService(ROUTER, of("routes", name), { method: "PUT", json });
export const deleteRoute = (name: string): Promise<unknown> => requestService(ROUTER, of("routes", name), { method: "DELETE" });
export const routesOf = (json: AlertExample): Promise<RouteAnswer[]> => requestService(ROUTER, "routes/test", { method: "POST", json });

/** Save a channel; a webhook without a secret keeps the one that it has. */
export const saveChannel = (name: string, json: Channel): Promise<ChannelView> => requestService(ROUTER, `${of("channels", name)}?keepSecret=true`, { method: "PUT", json });
export const deleteChannel = (name: string): Promise<unknown> => requestService(ROUTER, of("channels", name), { method: "DELETE" });
export const testChannel = (name: string): Promise<TestResult> => requestService(ROUTER, `${of("channels", name)}/test`, { method: "POST" });
