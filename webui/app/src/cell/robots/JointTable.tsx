/** The joints with their ranges and the position of the tool's tip, as a table. */
import { useTranslation } from "react-i18next";
import { useTopic } from "~/live/hooks";
import { type JointDescription, labelOf, positionText, rangeText, type RobotDescription, speedText } from "~/robot/description";
import { metres } from "~/robot/units";

export function JointTable({ robot, description }: { robot: string; description: RobotDescription | null }) {
  const { t, i18n } = useTranslation("system");
  const view = useTopic(`robot/${robot}`);
  if (view === undefined) return null;
  const { name, position, velocity } = view.joints;
  const described = (joint: string) => description?.joints.find((each) => each.name === joint) ?? undescribed(joint);
  return (
    <section className="joints">
      <table>
        <caption className="visually-hidden">{t("joint.title")}</caption>
        <thead>
          <tr>
            <th scope="col">{t("joint.name")}</th>
            <th scope="col">{t("joint.position")}</th>
            <th scope="col">{t("joint.speed")}</th>
            <th scope="col">{t("joint.range")}</th>
          </tr>
        </thead>
        <tbody>
          {name.map(described).map((joint, number) => (
            <tr key={joint.name}>
              <th scope="row">{labelOf(joint, i18n.language)}</th>
              <td>{positionText(joint, position[number] ?? NaN, i18n.language)}</td>
              <td>{speedText(joint, velocity[number] ?? NaN, i18n.language)}</td>
              <td className="joints__range quiet">{description !== null && rangeText(joint, i18n.language)}</td>
            </tr>
          ))}
        </tbody>
      </table>
      <p className="joints__tool">
        <span className="joints__tip quiet">{t("joint.tool")}</span>
        {(["x", "y", "z"] as const).map((axis, number) => (
          <span key={axis} className="joints__axis">
            {axis} {metres(view.toolPose.position[number] ?? NaN, i18n.language)} m
          </span>
        ))}
      </p>
    </section>
  );
}

/** A joint without a description. */
function undescribed(name: string): JointDescription {
  return { name, type: "revolute", unit: "rad", lower: null, upper: null, maxVelocity: 0, labels: {} };
}
