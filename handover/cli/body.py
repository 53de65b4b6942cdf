"""`handover body`: sensors of the body, recordings of persons who consent, export and deletion."""

import getpass
import hashlib
from pathlib import Path
from typing import Annotated, Any, Final

import httpx
import typer

from handover.cli.access import ask_service
from handover.durable_files import replace_durably
from handover.errors import UsageError
from services.human_state.settings import HumanStateSettings

app = typer.Typer(
    help="Body signals of persons who consent: search, record, export, delete.", no_args_is_help=True
)

FORMATS: Final = {"mcap": "file", "xdf": "xdf", "fhir": "bundle"}
SUFFIXES: Final = {"mcap": "mcap", "xdf": "xdf", "fhir": "fhir.json"}

Person = Annotated[str, typer.Argument(help="The name of the person, as on the page People.")]
Recording = Annotated[str, typer.Argument(help="The id of the recording: R- and 16 hexadecimal digits.")]


@app.command()
def people() -> None:
    """List the persons with what they allow and how their sensors do."""
    for one in _ask("GET", "/people").json():
        print(f"{one['person']:<24} {one['pseudonym']:<14} {', '.join(one['purposes']) or 'no consent'}")
        for sensor in one["sensors"]:
            state = sensor["fault"] or sensor["link"] or "not running"
            print(f"  {sensor['name']:<22} {sensor['driver']:<18} {state:<12} {sensor['problem']}".rstrip())


@app.command()
def discover(
    driver: Annotated[str | None, typer.Argument(help="A driver; all are listed without.")] = None,
    seconds: Annotated[float, typer.Option("--for", min=0.1, max=25, help="How long to search, in s.")] = 5.0,
) -> None:
    """Search for devices of a driver."""
    if driver is None:
        for one in _ask("GET", "/drivers").json():
            print(f"{one['name']:<20} {one['description']}")
        return
    found = _ask("POST", f"/drivers/{driver}/discover", params={"timeout_s": seconds}).json()
    for one in found:
        strength = "" if one["rssiDbm"] is None else f"{one['rssiDbm']} dBm"
        print(f"{one['address']:<40} {one['name']:<28} {strength}".rstrip())
    if not found:
        print(f"no device of {driver} answered within {seconds:g} s; is it worn, charged and near?")


@app.command()
def record(
    person: Person,
    label: Annotated[str, typer.Option("--label", help="A name for the recording.")] = "",
    stop: Annotated[bool, typer.Option("--stop", help="Stop the recording that runs.")] = False,
    marker: Annotated[str | None, typer.Option("--mark", help="Set a marker in the one that runs.")] = None,
) -> None:
    """Start a recording and print its id; --mark sets a marker in it, and --stop ends it."""
    path = f"/people/{person}/recordings"
    if not stop and marker is None:
        print(_ask("POST", path, json={"label": label, "startedBy": getpass.getuser()}).json()["id"])
        return
    running = _ask("GET", f"/people/{person}").json()["recording"]
    if running is None:
        raise UsageError(f"nothing is recorded of {person}; start with: handover body record {person}")
    if marker is not None:
        _ask("POST", f"{path}/{running}/markers", json={"name": marker})
    if stop:
        ended = _ask("POST", f"{path}/{running}/stop").json()
        print(f"{running} has {ended['size']:,} bytes, SHA-256 {ended['sha256']}")


@app.command()
def recordings(person: Person) -> None:
    """List the recordings of a person, newest first."""
    for one in _ask("GET", f"/people/{person}/recordings").json():
        size = "" if one["size"] is None else f"{one['size']:,} bytes"
        print(f"{one['id']}  {one['started']:<28} {one['state']:<12} {size:<18} {one['label']}".rstrip())


@app.command()
def export(
    person: Person,
    recording: Recording,
    form: Annotated[str, typer.Option("--format", help="mcap, xdf or fhir.")] = "mcap",
    file: Annotated[Path | None, typer.Option("--file", help="Where to; the id if absent.")] = None,
) -> None:
    """Write a recording to a file, which is not encrypted any more; the SHA-256 of MCAP is checked."""
    if form not in FORMATS:
        raise UsageError(f'there is no format "{form}"; choose from {", ".join(FORMATS)}')
    path = f"/people/{person}/recordings"
    wanted = {one["id"]: one["sha256"] for one in _ask("GET", path).json()}
    content = _ask("GET", f"{path}/{recording}/{FORMATS[form]}").content
    if form == "mcap" and hashlib.sha256(content).hexdigest() != wanted.get(recording):
        raise UsageError(f"{recording} was damaged on its way: its SHA-256 is another one; export it again")
    target = Path(f"{recording}.{SUFFIXES[form]}") if file is None else file
    try:
        replace_durably(target, content, mode=0o600)
    except OSError as error:
        raise UsageError(f"{target} cannot be written: {error.strerror}; choose another --file") from None
    print(target)


@app.command()
def delete(
    person: Person,
    recording: Annotated[str | None, typer.Option("--recording", help="This recording only.")] = None,
    everything: Annotated[
        bool, typer.Option("--everything", help="The person too, with consent and sensors.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
) -> None:
    """Delete a recording, or all values and recordings of a person, here and in the broker."""
    if recording is not None and everything:
        raise UsageError("say either --recording or --everything")
    what = (
        f"recording {recording}" if recording else "everything" if everything else "all values and recordings"
    )
    if not yes and not typer.confirm(f"Delete {what} of {person}? This cannot be undone."):
        raise typer.Exit(1)
    path = f"/people/{person}"
    if recording is not None:
        path += f"/recordings/{recording}"
    elif not everything:
        path += "/data"
    _ask("DELETE", path)
    print(f"{what} of {person}: deleted")


def _ask(method: str, path: str, **request: Any) -> httpx.Response:
    settings = HumanStateSettings.load()
    return ask_service("human state", settings, method, settings.service_url, path, **request)
