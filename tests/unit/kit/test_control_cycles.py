"""Functions that run in a control cycle (`@runs_in_cycle`) do not wait, and no coroutine calls them."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from handover.runtime.control_cycle import MARK, runs_in_cycle
from tests.kit.paths import REPOSITORY

SERVICES = ("trajectory_tool", "whole_body_control")
WAITING_MODULES = {
    "aiomqtt", "asyncio", "httpx", "requests", "shutil", "socket", "sqlite3", "subprocess", "urllib",
    "websockets",
}  # fmt: skip
WAITING_CALLS = {"open", "input", "print", "time.sleep", "os.open", "os.fsync", "os.replace"}
WAITING_METHODS = {"mkdir", "open", "read_bytes", "read_text", "unlink", "write_bytes", "write_text"}


@dataclass(frozen=True)
class Function:
    """A function of a module, or a method of a class."""

    owner: str
    """The class, or the name of the module."""
    node: ast.FunctionDef | ast.AsyncFunctionDef

    @property
    def is_marked(self) -> bool:
        return any(ast.unparse(decorator) == MARK for decorator in self.node.decorator_list)

    @property
    def is_generator(self) -> bool:
        """A call of it only makes work, which the control thread does."""
        return any(isinstance(node, ast.Yield | ast.YieldFrom) for node in ast.walk(self.node))


def functions_of(name: str, tree: ast.Module) -> Iterator[Function]:
    owners: list[tuple[str, list[ast.stmt]]] = [(name, tree.body)]
    owners += [(node.name, node.body) for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    for owner, body in owners:
        for node in body:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield Function(owner, node)


def bases_of(tree: ast.Module) -> dict[str, list[str]]:
    classes = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    return {node.name: [ast.unparse(base).partition("[")[0] for base in node.bases] for node in classes}


def faults_of(modules: dict[str, str]) -> list[str]:
    """Return what marked functions of modules (name: source) do that they must not, and who calls them."""
    trees = {name: ast.parse(source) for name, source in modules.items()}
    functions = [function for name, tree in trees.items() for function in functions_of(name, tree)]
    bases: dict[str, list[str]] = {}
    for tree in trees.values():
        bases |= bases_of(tree)
    marked = {(function.owner, function.node.name) for function in functions if function.is_marked}
    called = marked - {
        (function.owner, function.node.name) for function in functions if function.is_generator
    }
    faults = []
    for function in functions:
        place = f"{function.owner}.{function.node.name}"
        line = (function.owner, *ancestors_of(function.owner, bases))
        if function.is_marked:
            faults += [f"{place} {fault}" for fault in waiting(function.node)]
        elif any((owner, function.node.name) in marked for owner in line):
            faults.append(f"{place} overrides a marked function and is not marked")
        if isinstance(function.node, ast.AsyncFunctionDef):
            faults += [
                f"{place} is a coroutine and calls {name}"
                for name in own_calls(function.node)
                if any((owner, name) in called for owner in line)
            ]
    return faults


def ancestors_of(owner: str, bases: dict[str, list[str]]) -> Iterator[str]:
    for base in bases.get(owner, []):
        yield base
        yield from ancestors_of(base, bases)


def waiting(node: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[str]:
    if isinstance(node, ast.AsyncFunctionDef):
        yield "is a coroutine"
    for part in ast.walk(node):
        if isinstance(part, ast.Await | ast.AsyncFor | ast.AsyncWith):
            yield "awaits"
        if isinstance(part, ast.Call):
            called = ast.unparse(part.func)
            method = part.func.attr if isinstance(part.func, ast.Attribute) else ""
            if (
                called in WAITING_CALLS
                or called.partition(".")[0] in WAITING_MODULES
                or method in WAITING_METHODS
            ):
                yield f"calls {called}"
        if isinstance(part, ast.For | ast.While) and any(map(is_logging, ast.walk(part))):
            yield "logs in a loop"


def is_logging(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and ast.unparse(node.func).startswith("log.")


def own_calls(node: ast.AST) -> Iterator[str]:
    """Yield what a coroutine itself calls by `name(…)` or `self.name(…)`; not what it hands on."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(child, ast.Call):
            called = ast.unparse(child.func).removeprefix("self.").removeprefix("super().")
            if "." not in called:
                yield called
        yield from own_calls(child)


def sources(service: str) -> dict[str, str]:
    """Return the modules of all packages of a service, by their names."""
    root = REPOSITORY / "services" / service
    packages = [*root.glob("handover_*"), *root.glob("*/handover_*")]
    return {
        ".".join(path.relative_to(package.parent).with_suffix("").parts): path.read_text(encoding="utf-8")
        for package in sorted(packages)
        for path in sorted(package.rglob("*.py"))
    }


@pytest.mark.parametrize("service", SERVICES)
def test_functions_of_control_cycles_do_not_wait(service: str) -> None:
    assert faults_of(sources(service)) == []


@pytest.mark.parametrize(
    "name",
    [
        "handover_robots.driver_base.control_thread",
        "handover_robots.driver_base.cyclic_robot",
        "handover_robots.drivers.ros_robot",
        "handover_ur.driver",
        "handover_humanoid.cycle.loop",
        "handover_humanoid.behaviours.humanoid_component",
    ],
)
def test_the_cycles_of_robots_are_marked(name: str) -> None:
    source = next(modules[name] for modules in map(sources, SERVICES) if name in modules)
    assert any(function.is_marked for function in functions_of(name, ast.parse(source)))


def test_the_mark_is_an_attribute_and_costs_no_call() -> None:
    def command() -> None:
        pass

    assert runs_in_cycle(command) is command
    assert getattr(command, MARK)


@pytest.mark.parametrize(
    ("source", "fault"),
    [
        ("@runs_in_cycle\nasync def cycle(): pass", "cycles.cycle is a coroutine"),
        ("@runs_in_cycle\ndef cycle():\n    for _ in range(2): log.info('x')", "cycles.cycle logs in a loop"),
        ("@runs_in_cycle\ndef cycle(): time.sleep(1)", "cycles.cycle calls time.sleep"),
        ("@runs_in_cycle\ndef cycle(path): path.write_text('x')", "cycles.cycle calls path.write_text"),
        ("@runs_in_cycle\ndef cycle(): httpx.get('x')", "cycles.cycle calls httpx.get"),
        (
            "class Base:\n    @runs_in_cycle\n    def command(self): pass\n"
            "class Robot(Base):\n    @runs_in_cycle\n    def command(self): pass\n"
            "    async def move(self): self.command()",
            "Robot.move is a coroutine and calls command",
        ),
        (
            "class Base:\n    @runs_in_cycle\n    def command(self): pass\n"
            "class Robot(Base):\n    def command(self): pass",
            "Robot.command overrides a marked function and is not marked",
        ),
    ],
)
def test_a_function_that_waits_is_found(source: str, fault: str) -> None:
    assert faults_of({"cycles": source}) == [fault]


def test_work_that_is_handed_to_the_control_thread_is_no_fault() -> None:
    source = (
        "class Robot:\n"
        "    @runs_in_cycle\n"
        "    def command(self): pass\n"
        "    @runs_in_cycle\n"
        "    def cycles(self): yield\n"
        "    async def move(self):\n"
        "        await self.in_control(lambda: self.command())\n"
        "        await self.in_cycles(self.cycles())"
    )
    assert faults_of({"robots": source}) == []
