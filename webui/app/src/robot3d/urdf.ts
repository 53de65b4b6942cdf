/** Robots of URDF texts, drawn with plain shapes: cylinders, boxes and spheres. */
import type { Object3D } from "three";
import { Box3, CylinderGeometry, Group, LineSegments, Mesh, MeshStandardMaterial, SphereGeometry, Vector3 } from "three";
import URDFLoader, { type URDFLink, type URDFRobot } from "urdf-loader";
import type { FingerDescription } from "~/robot/description";

const UP = new Vector3(0, 1, 0);
const SAME_M = 1e-4;

/** The description of a robot cannot be drawn. */
export class InvalidDescription extends Error {}

/**
 * The robot of a URDF text; its parts cast shadows. Mesh files are not loaded: a link without plain shapes is
 * drawn as its collision shapes, or as rods to its joints. Throws `InvalidDescription`.
 */
export function parsed(urdf: string): URDFRobot {
  const loader = new URDFLoader();
  loader.parseCollision = true;
  loader.packages = () => "";
  loader.loadMeshCb = (_url, _manager, _material, onLoad) => onLoad(new Group());
  const robot = read(loader, urdf);
  robot.updateMatrixWorld(true);
  const rod = rodRadius(robot);
  for (const link of Object.values(robot.links)) showSomething(link, rod);
  robot.traverse((part) => {
    if (part instanceof Mesh) part.castShadow = part.receiveShadow = true;
  });
  return robot;
}

function read(loader: URDFLoader, urdf: string): URDFRobot {
  try {
    return loader.parse(urdf);
  } catch (error) {
    throw new InvalidDescription(String(error));
  }
}

/** Show the visual shapes of a link, else its collision shapes, else rods from its frame to its joints. */
function showSomething(link: URDFLink, rod: number): void {
  const visuals = link.children.filter((part) => "isURDFVisual" in part && drawn(part));
  const colliders = link.children.filter((part) => "isURDFCollider" in part);
  const asColliders = visuals.length === 0 && colliders.some(drawn);
  for (const collider of colliders) if (!asColliders) release(collider);
  if (visuals.length > 0 || asColliders) return;
  for (const joint of link.children.filter((part) => "isURDFJoint" in part)) {
    if (joint.position.length() > SAME_M) link.add(rodTo(joint.position, rod));
  }
}

function drawn(part: Object3D): boolean {
  let found = false;
  part.traverse((child) => {
    found ||= child instanceof Mesh;
  });
  return found;
}

function rodTo(end: Vector3, radius: number): Group {
  const material = new MeshStandardMaterial({ color: "#9aa3b0", roughness: 0.7 });
  const length = end.length();
  const rod = new Mesh(new CylinderGeometry(radius, radius, length), material);
  rod.quaternion.setFromUnitVectors(UP, end.clone().normalize());
  rod.position.copy(end).multiplyScalar(0.5);
  const knot = new Mesh(new SphereGeometry(radius * 1.4), material);
  knot.position.copy(end);
  const group = new Group();
  group.add(rod, knot);
  return group;
}

/** Rods as thick as suits the size of the robot. */
function rodRadius(robot: URDFRobot): number {
  const origin = new Vector3().setFromMatrixPosition(robot.matrixWorld);
  const distances = Object.values(robot.links).map((link) => new Vector3().setFromMatrixPosition(link.matrixWorld).distanceTo(origin));
  return 0.03 * Math.max(...distances, 0.1);
}

/** Move the joints by name (rad or m); unknown joints are ignored. */
export function bend(robot: URDFRobot, names: readonly string[], positions: readonly number[]): void {
  names.forEach((name, number) => {
    const angle = positions[number];
    if (angle !== undefined && name in robot.joints) robot.setJointValue(name, angle);
  });
}

/** Open or close the fingers; they close around a part, or completely. */
export function grip(robot: URDFRobot, fingers: readonly FingerDescription[], closed: boolean, holds: boolean): void {
  for (const { joint, ...at } of fingers) {
    if (joint in robot.joints) robot.setJointValue(joint, closed ? (holds ? at.holding : at.closed) : at.opened);
  }
}

/** The box around the robot with its joints at given positions, and the box around its root link. */
export function boxesOf(robot: URDFRobot, names: readonly string[], positions: readonly number[]): { robot: Box3; root: Box3 } {
  bend(robot, names, positions);
  robot.updateMatrixWorld(true);
  const root = new Box3();
  for (const part of robot.children) if ("isURDFVisual" in part || "isURDFCollider" in part) root.expandByObject(part);
  return { robot: new Box3().setFromObject(robot), root };
}

/** Release the graphics memory of `object` and its children. */
export function release(object: Object3D): void {
  object.traverse((part) => {
    if (!(part instanceof Mesh || part instanceof LineSegments)) return;
    const { geometry, material } = part as Mesh;
    geometry.dispose();
    for (const each of Array.isArray(material) ? material : [material]) each.dispose();
  });
  object.removeFromParent();
}
