"""`handover process offers`: definitions that other systems have written to the broker."""

from typing import Annotated

import typer

from handover.command_line.output import AsJson, print_json
from handover_processes.command_line.asking import By, Why, ask

offers = typer.Typer(help="Definitions that other systems have written to the broker.", no_args_is_help=True)


@offers.command("list")
def list_offers(
    status: Annotated[
        str, typer.Option("--status", help="open, accepted, rejected, superseded or withdrawn.")
    ] = "open",
    as_json: AsJson = False,
) -> None:
    """List the offers of a status, the latest first."""
    listed = ask("GET", "/offers", params={"status": status})
    if as_json:
        print_json(listed)
        return
    for offer in listed:
        print(f"{offer['id']}  {offer['type']:<22} {offer['name']}")
        for fault in offer["faults"]:
            print(f"  fault: {fault['element'] or 'the file'}: {fault['message']}")
    if not listed:
        print(f"no offer is {status}")


Offer = Annotated[str, typer.Argument(help="The id of the offer, as `offers list` shows it.")]


@offers.command("show")
def show_offer(offer: Offer) -> None:
    """Show what an offer would change, and who would get the work."""
    view = ask("GET", f"/offers/{offer}")
    print(f"{view['name']} ({view['type']}, {view['status']}) of {view['entity']}")
    for definition in view["definitions"]:
        print(f"becomes version {definition['version']} of {definition['title']}")
    for change in view["changes"]:
        print(f"{change['change']:<8} {change['name'] or change['element']}")
    for kind in ("fault", "warning"):
        for finding in view[f"{kind}s"]:
            print(f"{kind}: {finding['element'] or 'the file'}: {finding['message']}")
    for line in view["allocation"]:
        print(f"{line['name']}: {line['warning'] or line['reason']}")


@offers.command("accept")
def accept_offer(offer: Offer, by: By, why: Why = None) -> None:
    """Deploy a process, or put another definition in force."""
    view = ask("POST", f"/offers/{offer}/accept", json={"by": by, "why": why})
    print(f"{view['name']} is accepted")


@offers.command("reject")
def reject_offer(offer: Offer, by: By, why: Why = None) -> None:
    """Reject an offer; the same content is not offered again."""
    view = ask("POST", f"/offers/{offer}/reject", json={"by": by, "why": why})
    print(f"{view['name']} is rejected")
