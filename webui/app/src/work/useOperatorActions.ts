/** The operator's actions in a situation: the main action, answering on the screen, pausing, resuming. */
import { useTranslation } from "react-i18next";
import { retryToken, startOperator, startProcess } from "~/api/actions";
import type { DefinitionView } from "~/api/generated/task-orchestrator";
import type { Outcome } from "~/live/messages";
import { mayDo } from "~/session/session";
import { answerByHand, endTesting, pauseGlove, requestStatus, resumeGlove } from "./actions";
import { startRequest } from "./confirmation";
import { latest, parametersFor, type Scene, type Situation } from "./situation";
import type { ActionState } from "./useAction";

export interface Act {
  name: string;
  do: () => void;
}

export interface OperatorActions {
  main: Act | null;
  complete: Act | null;
  /** Report another outcome than `ok`; rejects if refused, resolves once the name is known. */
  report: ((outcome: Outcome, note: string) => Promise<void>) | null;
  pause: (Act & { goesOn: boolean }) | null;
  start: ((definition: DefinitionView) => void) | null;
}

type WithName = (act: (name: string) => Promise<unknown>) => Promise<void>;

export function useOperatorActions(scene: Scene, situation: Situation, acting: ActionState, withName: WithName, askPin: () => void): OperatorActions {
  const { t } = useTranslation("work");
  const { perform } = acting;
  const complete = completeAct();
  const pause = pauseAct();
  const start = "startable" in situation && mayDo("runProcesses") ? startWith(situation.glove.glove) : null;
  const report = complete === null || needsPin() ? null : reportWith();
  return { main: mainAct(), complete, report, pause, start };

  function startWith(glove: string) {
    return (definition: DefinitionView) => {
      const request = startRequest(glove, definition.name, latest(scene.processes)?.id ?? null);
      perform(() => startProcess(definition.name, parametersFor(definition, glove), { request }));
    };
  }

  function needsPin(): boolean {
    return "glove" in situation && situation.glove.task?.needsPin === true;
  }

  function completeAct(): Act | null {
    if (!mayDo("performTasks")) return null;
    if (situation.kind !== "prompt" && situation.kind !== "gloveLost") return null;
    if (situation.glove.testing) return null;
    if (needsPin()) return { name: t("by.pin"), do: askPin };
    const { glove, task } = situation.glove;
    return { name: t("by.hand"), do: () => perform(() => withName((name) => answerByHand(glove, task?.id, name))) };
  }

  function reportWith() {
    if (situation.kind !== "prompt" && situation.kind !== "gloveLost") return null;
    const { glove, task } = situation.glove;
    return (outcome: Outcome, note: string) => withName((name) => answerByHand(glove, task?.id, name, outcome, note));
  }

  function pauseAct(): OperatorActions["pause"] {
    if (!mayDo("performTasks")) return null;
    const act = (goesOn: boolean, does: () => Promise<unknown>) => ({
      name: t(goesOn ? "strip.goOn" : "strip.pause"),
      goesOn,
      do: () => perform(does),
    });
    switch (situation.kind) {
      case "paused":
        return situation.glove.message.key === "pausedByProcess"
          ? act(true, () => requestStatus(situation.task.id, "inProgress"))
          : act(true, () => resumeGlove(situation.glove.glove));
      case "prompt":
      case "gloveLost":
        return act(false, () => pauseGlove(situation.glove.glove));
      case "robot":
        return situation.task.status === "paused"
          ? act(true, () => requestStatus(situation.task.id, "inProgress"))
          : act(false, () => requestStatus(situation.task.id, "paused"));
      case "idle":
      case "completed":
      case "failed":
      case "incident":
      case "between":
        return situation.glove.paused ? act(true, () => resumeGlove(situation.glove.glove)) : null;
      default:
        return null;
    }
  }

  function mainAct(): Act | null {
    switch (situation.kind) {
      case "prompt":
        return situation.glove.testing ? leaveTesting(situation.glove.glove) : complete;
      case "gloveLost":
        return complete;
      case "paused":
        return pause;
      case "incident": {
        if (!mayDo("runProcesses")) return null;
        const { process, incident } = situation;
        return { name: t("by.retry"), do: () => perform(() => withName((name) => retryToken(process.id, incident.token, { by: name }))) };
      }
      case "failed":
        return startAct("by.startAgain");
      case "completed":
        return situation.glove.testing ? leaveTesting(situation.glove.glove) : startAct("by.startAgain");
      case "idle":
        return situation.glove.testing ? leaveTesting(situation.glove.glove) : startAct("by.start");
      case "noGlove":
        return mayDo("configure") ? { name: t("by.simulate"), do: () => perform(() => startOperator(situation.chosen ?? "glove-1")) } : null;
      default:
        return null;
    }
  }

  function leaveTesting(glove: string): Act | null {
    if (!mayDo("configure")) return null;
    return { name: t("by.endTesting"), do: () => perform(() => endTesting(glove)) };
  }

  function startAct(words: "by.start" | "by.startAgain"): Act | null {
    if (!mayDo("runProcesses")) return null;
    const definition = "startable" in situation ? situation.startable[0] : undefined;
    if (definition === undefined || start === null) return null;
    return { name: t(words, { title: definition.title }), do: () => start(definition) };
  }
}
