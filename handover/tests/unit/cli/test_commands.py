"""Commands of other packages: found by their entry points, and harmless where they cannot be loaded."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from handover.command_line.commands import COMMANDS, commands_of
from handover.command_line.main import app, main
from handover.errors import UsageError
from handover.extensions import SERVICES, ExtensionPoint
from requirements.subset import members

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


def test_a_command_of_a_missing_part_names_its_distribution(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names = [name for name in COMMANDS.names() if name != "humanoid"]
    monkeypatch.setattr(ExtensionPoint, "names", lambda self: names)
    monkeypatch.setattr(ExtensionPoint, "_registered", lambda self: {})
    fault = CliRunner().invoke(app, ["humanoid", "list"]).exception
    assert isinstance(fault, UsageError)
    assert "pip install --find-links dist handover-humanoid" in str(fault)


def test_a_command_of_a_group_whose_part_is_missing_names_the_part_and_is_not_listed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    others = {name: points for name, points in COMMANDS._registered().items() if name != "robot.simulate-ur"}
    monkeypatch.setattr(ExtensionPoint, "_registered", lambda self: others)
    fault = CliRunner().invoke(app, ["robot", "simulate-ur", "--port", "1"]).exception
    assert isinstance(fault, UsageError)
    assert "pip install --find-links dist handover-ur" in str(fault)
    assert "simulate-ur" not in CliRunner().invoke(app, ["robot", "--help"]).output


def test_a_missing_part_is_named_instead_of_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise ModuleNotFoundError("No module named 'handover_cases'", name="handover_cases.machine")

    monkeypatch.setattr("handover.command_line.main.app", fail)
    with pytest.raises(SystemExit, match="2"):
        main()
    assert "pip install --find-links dist handover-cases" in capsys.readouterr().err


def test_every_part_is_named_with_its_distribution() -> None:
    """What a message says to install is what registers the name."""
    for point in (COMMANDS, SERVICES):
        registered = {
            name: member
            for member, document in members().items()
            for name in document["project"].get("entry-points", {}).get(point.group, {})
        }
        kept = {name: member for name, member in registered.items() if name != "secrets"}
        assert {name: kept[name] for name in point.parts} == point.parts
        assert {name for name in kept if "." not in name} <= point.parts.keys()
