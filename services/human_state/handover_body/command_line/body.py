"""`handover body`: sensors of the body, recordings of persons who consent, export and deletion."""

import getpass
import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Final

import httpx
import typer

from handover.command_line.access import ask_service
from handover.command_line.output import AsJson, print_json
from handover.distribution import install_command
from handover.errors import UsageError
from handover.files.durable_files import replace_durably
from handover_body.settings import HumanStateSettings

app = typer.Typer(
    help="Body signals of persons who consent: search, record, export, delete.", no_args_is_help=True
)

FORMATS: Final = {"mcap": "file", "xdf": "xdf", "fhir": "bundle"}
SUFFIXES: Final = {"mcap": "mcap", "xdf": "xdf", "fhir": "fhir.json"}

Person = Annotated[str, typer.Argument(help="The name of the person, as on the page People.")]
Recording = Annotated[str, typer.Argument(help="The id of the recording: R- and 16 hexadecimal digits.")]


@app.command()
def people(as_json: AsJson = False) -> None:
    """List the persons with what they allow and how their sensors do."""
    listed = _ask("GET", "/people").json()
    if as_json:
        print_json(listed)
        return
    for row in listed:
        print(f"{row['person']:<24} {row['pseudonym']:<14} {', '.join(row['purposes']) or 'no consent'}")
        for sensor in row["sensors"]:
            state = sensor["fault"] or sensor["link"] or "not running"
            print(f"  {sensor['name']:<22} {sensor['driver']:<18} {state:<12} {sensor['problem']}".rstrip())
            for left in sensor["leftOut"]:
                print(f"    {left['name']} is left out: {left['reason']}")


@app.command()
def discover(
    driver: Annotated[str | None, typer.Argument(help="A driver; all are listed without.")] = None,
    seconds: Annotated[float, typer.Option("--for", min=0.1, max=25, help="How long to search, in s.")] = 5.0,
) -> None:
    """Search for devices of a driver."""
    if driver is None:
        for listed in _ask("GET", "/drivers").json():
            print(f"{listed['name']:<20} {listed['description']}")
        return
    devices = _ask("POST", f"/drivers/{driver}/discover", params={"timeout_s": seconds}).json()
    for device in devices:
        strength = "" if device["rssiDbm"] is None else f"{device['rssiDbm']} dBm"
        print(f"{device['address']:<40} {device['name']:<28} {strength}".rstrip())
    if not devices:
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
def recordings(person: Person, as_json: AsJson = False) -> None:
    """List the recordings of a person, newest first."""
    listed = _ask("GET", f"/people/{person}/recordings").json()
    if as_json:
        print_json(listed)
        return
    for recording in listed:
        size = "" if recording["size"] is None else f"{recording['size']:,} bytes"
        begin = f"{recording['id']}  {recording['started']:<28} {recording['state']:<12} "
        print(f"{begin}{size:<18} {recording['label']}".rstrip())


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
    wanted = {listed["id"]: listed["sha256"] for listed in _ask("GET", path).json()}
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
def analyse(
    file: Annotated[Path, typer.Argument(help="A recording: .hea, .edf, .bdf, .xdf, .mcap, .csv, .csv.gz.")],
    channel: Annotated[
        list[str] | None,
        typer.Option(
            "--channel", help="NAME=KIND or NAME=KIND[UNIT], such as CH1=eda[uS]; only these are read."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print features, channels, left_out.")] = False,
) -> None:
    """Show what the service would make of a recording; no service is needed, and nothing is stored."""
    try:
        from handover_body.drivers.recording.channels import Meaning  # noqa: PLC0415 - of an extra
        from handover_body.model.signals import SignalKind  # noqa: PLC0415 - of an extra
        from handover_body.monitoring.offline import BEGIN_S  # noqa: PLC0415 - of an extra
        from handover_body.monitoring.offline import analyse as analysed  # noqa: PLC0415 - of an extra
    except ImportError as error:
        raise UsageError(
            f"{error.name} is not installed; install the extra: {install_command('body')}"
        ) from error
    meanings = {}
    for text in channel or []:
        name, _, mapping = text.rpartition("=")
        kind, _, unit = mapping.removesuffix("]").partition("[")
        if not name or kind not in set(SignalKind):
            kinds = ", ".join(sorted(SignalKind))
            raise UsageError(
                f'"{text}" is no channel; write NAME=KIND or NAME=KIND[UNIT] with a kind of {kinds}'
            )
        meanings[name] = Meaning(SignalKind(kind), unit or None)
    analysis = analysed(file, meanings)
    if as_json:
        features = [
            {
                "name": feature.name,
                "value": feature.value,
                "at_s": round(feature.at_s - BEGIN_S, 3),
                "quality": round(feature.quality, 3),
                "status": feature.status,
                "channel": name,
            }
            for name, feature in analysis.features
        ]
        channels = [asdict(info) for info in analysis.channels]
        left_out = [asdict(track) for track in analysis.left_out]
        print(json.dumps({"features": features, "channels": channels, "left_out": left_out}))
        return
    for info in analysis.channels:
        rate = "irregular" if info.rate_hz is None else f"{info.rate_hz:g} Hz"
        print(f"{info.name}: {info.kind}, {rate}, {info.samples:,} samples")
        _print_features([feature for name, feature in analysis.features if name == info.name])
    for left in analysis.left_out:
        print(f"{left.name} is left out: {left.reason}")


def _print_features(features: list[Any]) -> None:
    for name in dict.fromkeys(feature.name for feature in features):
        values = [feature for feature in features if feature.name == name]
        valid = [feature.value for feature in values if feature.status == "valid"]
        shown = ", ".join(sorted(set(valid))) if valid and isinstance(valid[0], str) else ""
        if valid and not shown:
            shown = f"{min(valid):.4g} to {max(valid):.4g}"
        share = 100 * len(valid) / len(values)
        print(f"  {name:<20} {share:5.1f} % of {len(values)} values valid  {shown}".rstrip())


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
    return ask_service("human state", settings, method, settings.human_state, path, **request)
