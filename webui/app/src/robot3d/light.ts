/** Light, ground grid and their colours, the same in every 3D view whose z is up. */
import { AmbientLight, type ColorRepresentation, type DirectionalLight, GridHelper, HemisphereLight } from "three";

export function ambientLights(): (AmbientLight | HemisphereLight)[] {
  return [new HemisphereLight("#ffffff", "#8090a8", 1.3), new AmbientLight("#ffffff", 0.25)];
}

/** Let a light cast shadows within `reachM` around its target, at distances from `near` to `far` in m. */
export function castShadows(sun: DirectionalLight, reachM: number, near: number, far: number): void {
  sun.castShadow = true;
  sun.shadow.mapSize.set(1024, 1024);
  Object.assign(sun.shadow.camera, { left: -reachM, right: reachM, top: reachM, bottom: -reachM, near, far });
  sun.shadow.bias = -0.0006;
  sun.shadow.normalBias = 0.02;
}

/** A grid on the ground with four lines a metre. */
export function groundGrid(sizeM: number, colour: ColorRepresentation): GridHelper {
  return new GridHelper(sizeM, 4 * sizeM, colour, colour).rotateX(Math.PI / 2);
}
