"""Run the accounts service: `python -m services.accounts`."""

from handover.serving import run
from services.accounts.app import make_app
from services.accounts.settings import AccountsSettings

if __name__ == "__main__":
    run("accounts", make_app, AccountsSettings, port_field="accounts_port")
