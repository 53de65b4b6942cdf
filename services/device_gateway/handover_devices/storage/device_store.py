"""The store of the registry: descriptions, hashes of tokens, files. Every function blocks on the database."""

from collections.abc import Iterable
from dataclasses import dataclass

from sqlalchemy import Connection, Engine, delete, insert, select, update

from handover_devices.model.description import DeviceDescription
from handover_devices.storage import tables
from handover_devices.storage.history_writer import CommandRow, delete_history


@dataclass(frozen=True, slots=True)
class StoredDevice:
    """A device as the database has it."""

    name: str
    description: DeviceDescription
    token_sha256: str | None
    created_us: int
    updated_us: int
    certificate_sha256: str | None = None
    """The fingerprint of the certificate that the device may show instead of its token."""
    certificate_end_us: int | None = None


@dataclass(frozen=True, slots=True)
class DeviceFile:
    """A file of a device, such as its URDF."""

    media_type: str
    content: bytes


def load(engine: Engine) -> list[StoredDevice]:
    """Return all devices."""
    with engine.connect() as connection:
        return [
            StoredDevice(
                row.name,
                DeviceDescription.model_validate_json(row.description),
                row.token_sha256,
                row.created_us,
                row.updated_us,
                row.certificate_sha256,
                row.certificate_end_us,
            )
            for row in connection.execute(select(tables.devices).order_by(tables.devices.c.name))
        ]


def add(connection: Connection, device: StoredDevice) -> None:
    """Insert a device."""
    connection.execute(
        insert(tables.devices).values(
            name=device.name,
            description=device.description.model_dump_json(by_alias=True, exclude_defaults=True),
            token_sha256=device.token_sha256,
            certificate_sha256=device.certificate_sha256,
            certificate_end_us=device.certificate_end_us,
            created_us=device.created_us,
            updated_us=device.updated_us,
        )
    )


def replace(connection: Connection, device: StoredDevice) -> None:
    """Write the description of a device, the hash of its token and the fingerprint of its certificate."""
    connection.execute(
        update(tables.devices)
        .where(tables.devices.c.name == device.name)
        .values(
            description=device.description.model_dump_json(by_alias=True, exclude_defaults=True),
            token_sha256=device.token_sha256,
            certificate_sha256=device.certificate_sha256,
            certificate_end_us=device.certificate_end_us,
            updated_us=device.updated_us,
        )
    )


def remove(connection: Connection, name: str) -> None:
    """Delete a device with all of its history."""
    delete_history(connection, name)
    connection.execute(delete(tables.edge_marks).where(tables.edge_marks.c.edge == name))
    connection.execute(delete(tables.devices).where(tables.devices.c.name == name))


def save_file(connection: Connection, device: str, kind: str, file: DeviceFile | None) -> None:
    """Write a file of a device; None deletes it."""
    here = (tables.files.c.device == device) & (tables.files.c.kind == kind)
    connection.execute(delete(tables.files).where(here))
    if file is not None:
        connection.execute(
            insert(tables.files).values(
                device=device, kind=kind, media_type=file.media_type, content=file.content
            )
        )


def file_of(engine: Engine, device: str, kind: str) -> DeviceFile | None:
    """Return a file of a device."""
    here = (tables.files.c.device == device) & (tables.files.c.kind == kind)
    with engine.connect() as connection:
        row = connection.execute(select(tables.files).where(here)).first()
    return None if row is None else DeviceFile(row.media_type, row.content)


def files_of(engine: Engine, device: str) -> list[str]:
    """Return the kinds of files that a device has."""
    query = select(tables.files.c.kind).where(tables.files.c.device == device).order_by(tables.files.c.kind)
    with engine.connect() as connection:
        return list(connection.execute(query).scalars())


def edge_marks(engine: Engine) -> dict[str, tuple[str, int]]:
    """Return the stream of each edge and its last number that is stored."""
    with engine.connect() as connection:
        return {row.edge: (row.stream, row.seq) for row in connection.execute(select(tables.edge_marks))}


def commands(engine: Engine, states: Iterable[str]) -> list[CommandRow]:
    """Return the commands in these states, oldest first."""
    table = tables.commands
    query = select(table).where(table.c.state.in_(tuple(states))).order_by(table.c.created_us)
    with engine.connect() as connection:
        return [CommandRow(**row) for row in connection.execute(query).mappings()]


def last_commands(engine: Engine, limit: int) -> list[CommandRow]:
    """Return the newest commands of all devices, oldest first."""
    table = tables.commands
    query = select(table).order_by(table.c.created_us.desc()).limit(limit)
    with engine.connect() as connection:
        return [CommandRow(**row) for row in connection.execute(query).mappings()][::-1]


def command(engine: Engine, device: str, identifier: str) -> CommandRow | None:
    """Return one command."""
    table = tables.commands
    query = select(table).where((table.c.device == device) & (table.c.id == identifier))
    with engine.connect() as connection:
        row = connection.execute(query).mappings().first()
    return None if row is None else CommandRow(**row)


def commands_of(engine: Engine, device: str, limit: int) -> list[CommandRow]:
    """Return the newest commands of a device, newest first."""
    table = tables.commands
    query = select(table).where(table.c.device == device).order_by(table.c.created_us.desc()).limit(limit)
    with engine.connect() as connection:
        return [CommandRow(**row) for row in connection.execute(query).mappings()]
