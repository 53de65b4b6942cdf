/** Replaces a page that failed to render; the rest of the application keeps working. */
import { Component, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { UnknownAddress } from "~/route/choice";
import { UnknownName } from "~/route/UnknownName";

interface ErrorBoundaryProps {
  /** The address of the page; another one is tried again. */
  address: string;
  children: ReactNode;
}

export class ErrorBoundary extends Component<ErrorBoundaryProps, { fault: Error | null }> {
  override state: { fault: Error | null } = { fault: null };

  static getDerivedStateFromError(fault: Error) {
    return { fault };
  }

  override componentDidUpdate(before: ErrorBoundaryProps) {
    if (this.state.fault instanceof UnknownAddress && before.address !== this.props.address) this.setState({ fault: null });
  }

  override render() {
    const { fault } = this.state;
    if (fault instanceof UnknownAddress) return <UnknownName thing="value" name={fault.value} parameter={fault.parameter} />;
    return fault === null ? this.props.children : <ErrorPage fault={fault} />;
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
