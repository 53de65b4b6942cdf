/** The Study page: sessions and results for the study leader, the steps for a participant. */
import { useQueryParameter } from "~/route/queryParameter";
import { Overview } from "./Overview";
import { Participant } from "./Participant";
import "./StudyPage.css";

export default function StudyPage() {
  const [session, setSession] = useQueryParameter("session");
  return session === "" ? <Overview open={setSession} /> : <Participant key={session} session={session} />;
}
