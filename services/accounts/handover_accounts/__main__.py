"""Run the accounts service: `python -m handover_accounts`."""

from handover.serving.server import run
from handover_accounts.app import make_app
from handover_accounts.settings import AccountsSettings

if __name__ == "__main__":
    run("accounts", make_app, AccountsSettings, port_field="accounts_port")
