/** The joints in degrees, and where the tip of the tool is: the robot in numbers, with or without a picture. */
import { useTranslation } from "react-i18next";
import { useTopic } from "~/live/hooks";
import { degrees, metres } from "./angles";

export function JointTable({ robot }: { robot: string }) {
  const { t, i18n } = useTranslation("system");
  const view = useTopic(`robot/${robot}`);
  if (view === undefined) return null;
  const { name, position, velocity } = view.joints;
  return (
    <section className="joints">
      <table>
        <caption className="visually-hidden">{t("joint.title")}</caption>
        <thead>
          <tr>
            <th scope="col">{t("joint.name")}</th>
            <th scope="col">{t("joint.angle")}</th>
            <th scope="col">{t("joint.speed")}</th>
          </tr>
        </thead>
        <tbody>
          {name.map((joint, number) => (
            <tr key={joint}>
              <th scope="row">{t(`joint.of.${joint}`, { defaultValue: joint })}</th>
              <td>{degrees(position[number] ?? NaN, i18n.language)} °</td>
              <td>{degrees(velocity[number] ?? NaN, i18n.language)} °/s</td>
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
