"""Templates: descriptions of known robots, one YAML file each. Limits are those of the maker's data sheet."""

from functools import cache
from importlib.resources import files

import yaml

from handover.errors import Problem
from handover_devices.model.description import DeviceDescription


@cache
def templates() -> dict[str, DeviceDescription]:
    """Return the templates by name."""
    return {
        path.name.removesuffix(".yaml"): DeviceDescription.model_validate(yaml.safe_load(path.read_text()))
        for path in sorted(files(__package__).iterdir(), key=lambda path: path.name)
        if path.name.endswith(".yaml")
    }


def template(name: str) -> DeviceDescription:
    """Return a template; raise `Problem` 404 with the names that there are."""
    description = templates().get(name)
    if description is None:
        raise Problem.translated(
            404,
            "No such template",
            "device.template_unknown",
            'there is no template "{template}"; there are {known}',
            template=name[:64],
            known=", ".join(templates()),
        )
    return description
