/** An error message: the event, its effect on the work, and the remedy. */
import { TriangleAlert } from "lucide-react";
import type { ReactNode } from "react";
import { sentence } from "~/live/readable";
import "./ErrorMessage.css";

export function ErrorMessage({ children, act }: { children: ReactNode; act?: ReactNode }) {
  return (
    <div className="error-message" role="alert">
      <TriangleAlert aria-hidden size="1.3em" />
      <div className="error-message__text">{typeof children === "string" ? sentence(children) : children}</div>
      {act}
    </div>
  );
}
