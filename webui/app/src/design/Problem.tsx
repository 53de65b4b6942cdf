/** An error says what happened, what it means for the work, and what to do. */
import { TriangleAlert } from "lucide-react";
import type { ReactNode } from "react";
import "./Problem.css";

export function Problem({ children, act }: { children: ReactNode; act?: ReactNode }) {
  return (
    <div className="problem" role="alert">
      <TriangleAlert aria-hidden size="1.3em" />
      <div className="problem__words">{children}</div>
      {act}
    </div>
  );
}
