/** A button. `large` ones can be pressed with a glove: at least 64 px. */
import { Button as AriaButton, type ButtonProps as AriaButtonProps } from "react-aria-components";
import type { ReactNode } from "react";
import { mayDo, type Permission } from "~/session/session";
import "./Button.css";

export interface ButtonProps extends Omit<AriaButtonProps, "children" | "className"> {
  kind?: "main" | "plain" | "quiet" | "stop";
  size?: "normal" | "large";
  icon?: ReactNode;
  children?: ReactNode;
  /** The action, for a button that shows only its icon. */
  label?: string;
  /** What the action needs: the button is there only for users who have it. `MayNot` says who may. */
  permission?: Permission;
}

export function Button({ kind = "plain", size = "normal", icon, children, label, permission, ...rest }: ButtonProps) {
  if (permission !== undefined && !mayDo(permission)) return null;
  return (
    <AriaButton
      {...rest}
      {...(label === undefined ? {} : { "aria-label": label })}
      className={`button button--${kind} button--${size}`}
    >
      {icon}
      {children !== undefined && <span>{children}</span>}
    </AriaButton>
  );
}
