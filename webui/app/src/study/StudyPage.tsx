/** The Study page: sessions and what they say, for who leads the study; step by step for who takes part. */
import { useQueryParameter } from "~/route/queryParameter";
import { Overview } from "./Overview";
import { Participant } from "./Participant";
import "./StudyPage.css";

export default function StudyPage() {
  const [session, setSession] = useQueryParameter("session");
  return session === "" ? <Overview open={setSession} /> : <Participant key={session} session={session} />;
}
