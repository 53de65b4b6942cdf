"""Files of a user whose names are those of modules that services import."""

from pathlib import Path

NAMESAKES = (
    "random", "queue", "tempfile", "logging", "types", "httpx", "pydantic", "yaml",
    "handover", "handover_datamodels", "handover_cell", "handover_web", "glove_sdk_bridge", "handover_ros",
    "handover_broker", "handover_federation", "services", "webui",
)  # fmt: skip


def leave_namesakes_in(folder: Path) -> None:
    """Write modules and packages to `folder`; importing one ends the process."""
    for number, name in enumerate(NAMESAKES):
        text = f'raise SystemExit("{name} of the user was imported")\n'
        if number % 2:
            (folder / name).mkdir()
            (folder / name / "__init__.py").write_text(text)
        else:
            (folder / f"{name}.py").write_text(text)
