"""Commands of other packages: found by their entry points, and harmless where they cannot be loaded."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from handover.command_line.commands import commands_of
from handover.command_line.main import app
from handover.errors import UsageError

MODULE = """
import typer

lamp = typer.Typer(help="Lamps.")
weigh = typer.Typer()

@lamp.command()
def on() -> None:
    print("the lamp is on")

@lamp.command()
def off() -> None:
    print("the lamp is off")

@weigh.command()
def weigh_part(part: str) -> None:
    print(f"{part} weighs 2 kg")

NUMBER = 7
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package with commands, installed."""
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "lamp_commands.py").write_text(MODULE)
    metadata = tmp_path / "lamp_commands-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: lamp-commands\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(
        "[handover.commands]\n"
        "lamp = lamp_commands:lamp\n"
        "robot.weigh = lamp_commands:weigh\n"
        "broken = no_such_module:app\n"
        "number = lamp_commands:NUMBER\n"
        "up = lamp_commands:weigh\n"
        "run = lamp_commands:weigh\n"
    )


@pytest.mark.usefixtures("package")
def test_a_package_adds_commands_and_commands_below_those_of_others() -> None:
    runner = CliRunner()
    assert runner.invoke(app, ["lamp", "on"]).output == "the lamp is on\n"
    assert runner.invoke(app, ["robot", "weigh", "bolt"]).output == "bolt weighs 2 kg\n"
    assert "Lamps." in runner.invoke(app, ["--help"]).output
    assert "--install-completion" not in runner.invoke(app, ["lamp", "--help"]).output


@pytest.mark.usefixtures("package")
@pytest.mark.parametrize(("name", "why"), [("broken", "cannot be loaded"), ("number", "is no typer.Typer")])
def test_a_command_that_cannot_be_loaded_says_so_and_leaves_the_others_alone(name: str, why: str) -> None:
    runner = CliRunner()
    assert name in runner.invoke(app, ["--help"]).output
    failed = runner.invoke(app, [name, "--any", "option"])
    assert isinstance(failed.exception, UsageError)
    assert why in str(failed.exception)
    assert runner.invoke(app, ["lamp", "off"]).exit_code == 0


@pytest.mark.usefixtures("package")
def test_a_command_that_two_packages_register_names_both_and_leaves_the_others_alone() -> None:
    runner = CliRunner()
    fault = runner.invoke(app, ["up"]).exception
    assert isinstance(fault, UsageError)
    assert "two packages register the command" in str(fault)
    assert {"lamp-commands", "handover-cell"} <= set(re.findall(r"[a-z-]+", str(fault)))
    assert runner.invoke(app, ["lamp", "off"]).exit_code == 0


@pytest.mark.usefixtures("package")
def test_a_package_cannot_replace_a_command_of_the_kit() -> None:
    assert "Run one service" in dict(commands_of(app))[("run",)].help
