/** The links of a URDF whose shapes are files: this page does not have them, so it draws others in their place. */
export function linksWithMeshes(urdf: string): string[] {
  const links = new DOMParser().parseFromString(urdf, "application/xml").querySelectorAll("link");
  return [...links].filter((link) => link.querySelector("visual mesh") !== null).map((link) => link.getAttribute("name") ?? "");
}
