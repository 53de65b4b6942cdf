"""`handover device`: register devices and robots, list them, make tokens, simulate them."""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import httpx
import typer
import yaml

from handover.command_line.access import ask_service
from handover.command_line.output import AsJson, print_json
from handover.errors import UsageError
from handover.files.durable_files import replace_durably
from handover.network.tls_trust import client_context
from handover_devices.settings import GatewaySettings

app = typer.Typer(help="Devices and robots of others: add, list, simulate.", no_args_is_help=True)

Name = Annotated[str, typer.Argument(help="The name of the device.")]


@app.command()
def add(
    name: Name,
    template: Annotated[
        str | None, typer.Option("--template", help="ur10, panda, mycobot280, nao, or edge.")
    ] = None,
    file: Annotated[
        Path | None, typer.Option("--file", help="A YAML or JSON file with its description.")
    ] = None,
) -> None:
    """Register a device and print its token, which is shown only once."""
    if (template is None) == (file is None):
        raise UsageError("say what the device is: --template NAME or --file FILE")
    body: dict[str, Any] = {"name": name}
    body |= {"template": template} if file is None else {"description": _read(file)}
    _show_token(_ask("POST", "/devices", json=body).json())


@app.command("list")
def list_devices(as_json: AsJson = False) -> None:
    """List the devices with their state."""
    devices = list(_devices())
    if as_json:
        print_json(devices)
        return
    for device in devices:
        state = state_of(device)
        values = ", ".join(f"{name} {value['value']:g}" for name, value in list(device["values"].items())[:4])
        print(f"{device['name']:<24} {device['kind']:<12} {state:<14} {values}")


def state_of(device: Mapping[str, Any]) -> str:
    """Return the state of a device as the page shows it.

    A device that sends by HTTP or MQTT has values without a connection of its own: it is away once all of
    them are stale.
    """
    is_here = device["connected"] or any(not value["stale"] for value in device["values"].values())
    return str(device["state"] or "connected") if is_here else "away"


def _devices() -> Iterator[dict[str, Any]]:
    after = ""
    while page := _ask("GET", "/devices", params={"after": after, "limit": 500}).json():
        yield from page
        after = page[-1]["name"]


@app.command()
def token(
    name: Name,
    remove: Annotated[bool, typer.Option("--remove", help="Revoke the token instead.")] = False,
) -> None:
    """Make a new token for a device; the old one ends at once."""
    if remove:
        _ask("DELETE", f"/devices/{name}/token")
        print(f"{name} has no token any more")
        return
    _show_token(_ask("POST", f"/devices/{name}/token").json())


@app.command()
def certificate(
    name: Name,
    folder: Annotated[Path, typer.Option("--folder", help="Where the three files are written.")] = Path(),
    remove: Annotated[bool, typer.Option("--remove", help="Revoke the certificate instead.")] = False,
) -> None:
    """Make a client certificate for a device, an alternative to its token; the old one ends at once."""
    if remove:
        _ask("DELETE", f"/devices/{name}/certificate")
        print(f"{name} has no certificate any more")
        return
    made = _ask("POST", f"/devices/{name}/certificate").json()
    for file, part, mode in (
        (folder / f"{name}.key.pem", "key", 0o600),
        (folder / f"{name}.pem", "certificate", 0o644),
        (folder / "authority.pem", "authority", 0o644),
    ):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            replace_durably(file, made[part].encode(), mode=mode)
        except OSError as error:
            raise UsageError(
                f"{file} cannot be written: {error.strerror}; make the folder writable and run the command "
                "again, which makes another certificate"
            ) from None
        print(file)


@app.command()
def remove(name: Name) -> None:
    """Delete a device with its history."""
    _ask("DELETE", f"/devices/{name}")
    print(f"{name} is deleted")


@app.command()
def simulate(
    names: Annotated[
        list[str] | None, typer.Argument(help="Registered devices; without names one of each kind.")
    ] = None,
    period_s: Annotated[float, typer.Option("--period", help="The time between two messages in s.")] = 1.0,
    seconds: Annotated[float | None, typer.Option("--for", help="End after this many seconds.")] = None,
) -> None:
    """Play devices of every kind until stopped. A registered device that is named gets a new token."""
    from handover_devices.device_client import DeviceClient  # noqa: PLC0415
    from handover_devices.model.description import DeviceDescription  # noqa: PLC0415
    from handover_devices.simulation import SimulatedDevice, examples  # noqa: PLC0415

    settings = GatewaySettings.load()
    present_names = {device["name"] for device in _ask("GET", "/devices", params={"limit": 1000}).json()}
    if not names:
        for name, description in examples().items():
            if name not in present_names:
                body = {"name": name, "description": description.model_dump(mode="json", by_alias=True)}
                _ask("POST", "/devices", json=body)
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(settings.device_host, settings.device_host)  # noqa: S104
    tls = client_context(*settings.ca_files) if settings.has_device_tls else None
    played = []
    for name in names or examples():
        details = _ask("GET", f"/devices/{name}").json()["description"]
        secret = _ask("POST", f"/devices/{name}/token").json()["token"]
        client = DeviceClient(host, settings.device_port, name, secret, tls=tls)
        device = SimulatedDevice(client, DeviceDescription.model_validate(details), period_s)
        device.start()
        played.append(device)
    print(f"{len(played)} devices are simulated; Ctrl-C stops them", flush=True)
    ends_s = time.monotonic() + seconds if seconds is not None else float("inf")
    try:
        while time.monotonic() < ends_s and not all(device.client.refused for device in played):
            time.sleep(0.2)
    except KeyboardInterrupt:
        pass
    for device in played:
        if device.client.refused:
            print(f"{device.client.device}: {device.client.refused}")
        device.stop()


def _read(file: Path) -> Any:
    try:
        description = yaml.safe_load(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(f"{file} is no YAML: {error}") from None
    if not isinstance(description, dict) or "kind" not in description:
        raise UsageError(
            f'{file} describes no device: it needs "kind", such as "kind: sensor", and has the members of a '
            "description only, without the name (docs/how-to/devices.md)"
        )
    return description


def _show_token(made: dict[str, str]) -> None:
    print(f"The token of {made['name']} (it is shown only once):")
    print(made["token"])


def _ask(method: str, path: str, **request: Any) -> httpx.Response:
    settings = GatewaySettings.load()
    return ask_service("device gateway", settings, method, settings.device_gateway, path, **request)
