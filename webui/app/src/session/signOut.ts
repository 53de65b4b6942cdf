/** Ends the session of the user on this screen. */
import { request } from "~/api/http";

export async function signOut(): Promise<void> {
  const ended = await request<{ location: string | null }>("session", { method: "DELETE" }).catch(() => null); // an ended session is signed out as well
  location.replace(ended?.location ?? "/");
}
