/** The Study page: sessions and what they say, for who leads the study; step by step for who takes part. */
import { useQuery } from "~/route/query";
import { Overview } from "./Overview";
import { Participant } from "./Participant";
import "./StudyPage.css";

export default function StudyPage() {
  const [session, setSession] = useQuery("session");
  return session === "" ? <Overview open={setSession} /> : <Participant key={session} session={session} />;
}
