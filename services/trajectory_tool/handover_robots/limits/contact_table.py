"""Power and force limiting: the speed at which a contact with a body region stays within its limits.

The model has two bodies and a spring: the robot moves against a body region with its stiffness k. The energy
of the contact is E = mu v^2 / 2 = F^2 / (2 k), with the reduced mass 1/mu = 1/m_R + 1/m_H of robot and
region, and m_R = M/2 + m_L: half of the moving mass of the robot, and the load. So a contact at v has the
force F = v sqrt(mu k), and the pressure F over the contact area. A clamped body region cannot move away, so
its mass is infinite. Example: 10 kg against 0.6 kg at 75 N/mm, with 280 N permitted, allow 1.36 m/s.

The values are not ours: an engineer enters those that were validated for the cell, with the source and the
date. No value is supplied, since those of the standards are not freely available.
"""

import math
from pathlib import Path
from typing import Annotated, Self

import yaml
from pydantic import (
    AwareDatetime,
    Field,
    FiniteFloat,
    ValidationError,
)

from handover.errors import UsageError
from handover.formats.validation import ClosedModel, fault_lines
from handover.messages import message

MAX_FILE_BYTES = 256 * 1024

Positive = Annotated[FiniteFloat, Field(gt=0)]
Text = Annotated[str, Field(min_length=1, max_length=200)]


class ContactLimit(ClosedModel):
    """What one kind of contact may reach."""

    force_n: Positive
    pressure_n_per_cm2: Positive | None = None


class BodyRegion(ClosedModel):
    """A body region: its mass, stiffness, and limits for a free contact and for a clamped one."""

    mass_kg: Positive
    stiffness_n_per_mm: Positive
    transient: ContactLimit
    clamped: ContactLimit | None = None


class ContactTable(ClosedModel):
    """The limits by body region, where they come from, and who confirmed them for the cell."""

    source: Text
    confirmed_by: Text
    confirmed_at: AwareDatetime
    regions: Annotated[dict[Text, BodyRegion], Field(min_length=1, max_length=100)]


class ContactEntry(ClosedModel):
    """How people may be touched by one robot: which regions, by which mass, and with which area.

    `moving_mass_kg` is that of the moving parts of the robot, `load_kg` that of the tool and the part.
    `contact_area_cm2` is the smallest area that may touch.
    """

    table: Path
    regions: Annotated[tuple[Text, ...], Field(min_length=1)]
    moving_mass_kg: Positive
    load_kg: Annotated[FiniteFloat, Field(ge=0)] = 0.0
    contact_area_cm2: Positive | None = None
    may_clamp: bool = False


class ContactSpeed(ClosedModel):
    """The permitted speed of contacts of one robot, and the region that determines it."""

    region: str
    speed_mps: float
    table: ContactTable

    @property
    def reason(self) -> str:
        """Return why the speed is limited."""
        return message(
            "limit.contact_table",
            "{region}, confirmed on {date}",
            region=self.region,
            date=f"{self.table.confirmed_at:%Y-%m-%d}",
        )

    @classmethod
    def of(cls, entry: ContactEntry, table: ContactTable) -> Self:
        """Return the lowest speed of all regions. Raises `ValueError` for values that are missing."""
        speeds = []
        for name in entry.regions:
            region = table.regions.get(name)
            if region is None:
                raise ValueError(f'the table has no region "{name}"; it has {", ".join(table.regions)}')
            speeds.append((speed_mps(entry, name, region), name))
        slowest, name = min(speeds)
        return cls(region=name, speed_mps=slowest, table=table)


def speed_mps(entry: ContactEntry, name: str, region: BodyRegion) -> float:
    """Return the highest speed of a contact with a region. Raises `ValueError` for a missing value."""
    robot_kg = entry.moving_mass_kg / 2 + entry.load_kg
    reduced_kg = 1 / (1 / robot_kg + 1 / region.mass_kg)
    speeds_mps = [_contact_mps(entry, name, region.transient, reduced_kg, region.stiffness_n_per_mm)]
    if entry.may_clamp:
        if region.clamped is None:
            raise ValueError(f'the region "{name}" has no limit for a clamped contact; enter "clamped"')
        speeds_mps.append(_contact_mps(entry, name, region.clamped, robot_kg, region.stiffness_n_per_mm))
    return min(speeds_mps)


def _contact_mps(
    entry: ContactEntry, name: str, limit: ContactLimit, mass_kg: float, stiffness_n_per_mm: float
) -> float:
    force_n = limit.force_n
    if limit.pressure_n_per_cm2 is not None:
        if entry.contact_area_cm2 is None:
            raise ValueError(f'the region "{name}" has a limit of pressure; enter "contact_area_cm2"')
        force_n = min(force_n, limit.pressure_n_per_cm2 * entry.contact_area_cm2)
    return force_n / math.sqrt(mass_kg * stiffness_n_per_mm * 1000.0)


def read_contact_speed(entry: ContactEntry, folder: Path, robot: str) -> ContactSpeed:
    """Return the permitted speed for a robot; the table is looked for in `folder`. Raises `UsageError`."""
    path = folder / entry.table
    where = f"robots.{robot}.contact: the table {path}"
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise UsageError(f"{where} has more than {MAX_FILE_BYTES >> 10} kB")
        table = ContactTable.model_validate(yaml.safe_load(path.read_text(encoding="utf-8")))
        return ContactSpeed.of(entry, table)
    except OSError as error:
        raise UsageError(f"{where} cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(f"{where} is not YAML: {' '.join(str(error).split())}") from None
    except ValidationError as error:
        raise UsageError("\n".join(f"{where}: {line}" for line in fault_lines(error, "table"))) from None
    except ValueError as error:
        raise UsageError(f"{where}: {error}") from None
