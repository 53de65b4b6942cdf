/** Replaces a page that failed to render; the rest of the application keeps working. */
import { Component, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";

export class ErrorBoundary extends Component<{ children: ReactNode }, { fault: Error | null }> {
  override state: { fault: Error | null } = { fault: null };

  static getDerivedStateFromError(fault: Error) {
    return { fault };
  }

  override render() {
    return this.state.fault === null ? this.props.children : <ErrorPage fault={this.state.fault} />;
  }
}

function ErrorPage({ fault }: { fault: Error }) {
  const { t } = useTranslation("common");
  return (
    <EmptyState
      title={t("crash.title")}
      act={
        <Button kind="main" onPress={() => location.reload()}>
          {t("crash.act")}
        </Button>
      }
    >
      <p>{t("crash.means")}</p>
      <code>{fault.message}</code>
    </EmptyState>
  );
}
