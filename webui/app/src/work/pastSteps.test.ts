import { expect, test } from "vitest";
import { at, process, task } from "~/testing/views";
import { pastSteps } from "./pastSteps";

test("finished steps are shown with what was asked and answered, the newest first", () => {
  const done = { status: "completed", description: "Look at the part", workParameters: { gesture: "Thumbs up" } } as const;
  const steps = pastSteps(
    process({
      tasks: [
        task({ ...done, id: "1", endedAt: at(10), outputParameters: { by: "gesture", outcome: "ok" } }),
        task({ ...done, id: "2", status: "failed", endedAt: at(30), outputParameters: { by: "screen", operator: "Anna", outcome: "notGood", note: "scratched" } }),
        task({ id: "3", status: "inProgress" }),
        task({ id: "4", status: "failed", cancelled: true, endedAt: at(20) }),
        task({ id: "5", status: "failed", endedAt: at(25) }),
      ],
    }),
  );
  expect(steps.map(({ id, answer }) => [id, answer])).toEqual([
    ["2", "notGood"],
    ["5", "failed"],
    ["4", "cancelled"],
    ["1", "ok"],
  ]);
  expect(steps[0]).toMatchObject({ asked: "Look at the part", by: "screen", operator: "Anna", note: "scratched" });
  expect(steps.at(-1)).toMatchObject({ gesture: "Thumbs up", by: "gesture", operator: null });
});

test("a long process shows its last steps only", () => {
  const tasks = Array.from({ length: 200 }, (_, index) => task({ id: String(index), status: "completed", endedAt: at(index) }));
  const steps = pastSteps(process({ tasks }));
  expect(steps[0]?.id).toBe("199");
  expect(steps.length).toBe(20);
});
