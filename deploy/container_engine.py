"""The engine that runs containers: Docker where there is one, else podman, made ready from packages alone."""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PROJECT = "handover-try"
DISTRIBUTIONS = (
    "handover-cell",
    "handover-broker[federation]",
    "handover-processes",
    "handover-gloves[gif]",
    "handover-robots[physics,ur]",
    "handover-study",
    "handover-alerts[messengers]",
    "handover-devices",
    "handover-accounts",
    "handover-web",
)
"""Those of the containers that run without a profile, and the command line."""
COMMAND_LINE = "handover-cell"
"""Its image is called `handover`."""
BASE = "docker.io/library/python:3.12-slim"
PACKAGES = "podman buildah runc netavark aardvark-dns catatonit iptables debootstrap python3-venv"
COMPOSE_PLACE = Path("/var/cache/handover-try")
"""Where podman-compose stays from one run to the next."""
PODMAN_SETTINGS = """
[containers]
default_ulimits = ["nofile=20000:20000", "nproc=1000:1000"]
[engine]
runtime = "runc"
"""
WITHOUT_SYSTEMD = """
cgroup_manager = "cgroupfs"
events_logger = "file"
"""


class Failed(Exception):
    """The containers do not do what they must; the message says what."""


class Engine:
    """Docker or podman: what is called, with which environment."""

    def __init__(self, name: str, compose: list[str], environment: dict[str, str]) -> None:
        self.name = name
        self.compose_command = compose
        self.environment = {**os.environ, **environment}

    def __call__(self, *words: str, **more: Any) -> str:
        """Run the engine and return what it prints."""
        return call([self.name, *words], self.environment, **more)

    def compose(self, *words: str) -> str:
        """Run compose on the project."""
        return call([*self.compose_command, "-p", PROJECT, *words], self.environment)

    def inspect(self) -> dict[str, dict[str, Any]]:
        """Return all that the engine knows of the project's containers, by service."""
        ids = self("ps", "-aq", "--filter", f"label=com.docker.compose.project={PROJECT}").split()
        found = json.loads(self("inspect", *ids)) if ids else []
        return {each["Config"]["Labels"]["com.docker.compose.service"]: each for each in found}

    def check_health(self) -> None:
        """Run every container's health check once: podman leaves their timing to systemd."""
        for each in self.inspect().values():
            subprocess.run(
                [self.name, "healthcheck", "run", each["Id"]],
                env=self.environment,
                capture_output=True,
                check=False,
            )


def call(command: list[str], environment: dict[str, str], **more: Any) -> str:
    """Run a command in the repository and return what it prints; raise `Failed` with its last lines."""
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, **more
    )
    if done.returncode != 0:
        said = "\n".join((done.stdout + done.stderr).strip().splitlines()[-30:])
        raise Failed(f"{' '.join(command)} ended with {done.returncode}:\n{said}")
    return str(done.stdout)


def docker() -> Engine | None:
    """Return Docker if its engine answers and it has compose."""
    if shutil.which("docker") is None:
        return None
    for words in (["docker", "info"], ["docker", "compose", "version"]):
        if subprocess.run(words, capture_output=True, check=False).returncode != 0:
            return None
    return Engine("docker", ["docker", "compose"], {})


def podman(place: Path) -> Engine:
    """Return podman, installed if need be, with podman-compose and the base image."""
    needed = ("podman", "buildah", "runc", "debootstrap")
    if any(shutil.which(program) is None for program in needed):
        if os.geteuid() != 0 or shutil.which("apt-get") is None:
            raise Failed("there is no Docker engine; start one, or run this as root on Debian to have podman")
        environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        call(["apt-get", "update", "-qq"], environment)
        call(["apt-get", "install", "-y", "-qq", "--no-install-recommends", *PACKAGES.split()], environment)
    compose = COMPOSE_PLACE / "bin/podman-compose"
    if not compose.exists():
        call([sys.executable, "-P", "-m", "venv", str(COMPOSE_PLACE)], dict(os.environ))
        call([str(COMPOSE_PLACE / "bin/pip"), "install", "-q", "podman-compose"], dict(os.environ))
    settings = place / "containers.conf"
    with_systemd = Path("/run/systemd/private").exists()
    settings.write_text(PODMAN_SETTINGS + ("" if with_systemd else WITHOUT_SYSTEMD))
    engine = Engine(
        "podman",
        [str(compose)],
        {"CONTAINERS_CONF": os.environ.get("CONTAINERS_CONF", str(settings))},
    )
    if not engine("images", "-q", BASE).strip():
        make_base(engine, place)
    if not with_systemd:
        threading.Thread(target=check_health_again_and_again, args=(engine,), daemon=True).start()
    return engine


def make_base(engine: Engine, place: Path) -> None:
    """Make an image of Debian with its own Python, and give it the name that the Dockerfile asks for."""
    root = place / "base"
    sources = call(
        ["apt-get", "indextargets", "--format", "$(REPO_URI)", "Created-By: Packages"], dict(os.environ)
    )
    call(
        [
            *("debootstrap", "--variant=minbase"),  # all options come before the suite
            "--include=python3,python3-venv,python3-pip,ca-certificates",
            *("trixie", str(root), sources.split()[0]),
        ],
        dict(os.environ),
    )
    (root / "usr/bin/python").symlink_to("python3")
    with subprocess.Popen(
        ["tar", "-C", root, "--exclude=./var/cache/apt/*", "-c", "."], stdout=subprocess.PIPE
    ) as tar:
        engine("import", "-q", "-", BASE, stdin=tar.stdout)
    shutil.rmtree(root)


def check_health_again_and_again(engine: Engine) -> None:
    """Do what systemd would do for podman."""
    while True:
        with contextlib.suppress(Failed):
            engine.check_health()
        time.sleep(2)


def build(engine: Engine, place: Path) -> None:
    """Build the images, reaching pip's and npm's registries in the way this machine does."""
    secrets = {}
    for name in ("PIP_CERT", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE"):
        if os.environ.get(name):
            secrets["certificates"] = os.environ[name]
    trusted = "/run/secrets/certificates" if secrets else ""
    pip = {"cert": trusted, **of_pip()}
    secrets["pip.conf"] = written(
        place / "pip.conf", ["[global]", *(f"{k} = {v}" for k, v in pip.items() if v)]
    )
    npm = {"cafile": trusted, **of_npm()}
    secrets["npmrc"] = written(place / "npmrc", [f"{k}={v}" for k, v in npm.items() if v])
    words = [word for name, path in secrets.items() for word in ("--secret", f"id={name},src={path}")]
    for distribution in DISTRIBUTIONS:
        name = "handover" if distribution == COMMAND_LINE else distribution.partition("[")[0]
        chosen = ("--build-arg", f"DISTRIBUTION={distribution}")
        engine("build", "--network=host", "-t", f"{name}:latest", *chosen, *words, ".")


def of_pip() -> dict[str, str]:
    """Return how pip reaches its index here, as far as a container can use it."""
    listed = subprocess.run(
        [sys.executable, "-P", "-m", "pip", "config", "list"], capture_output=True, text=True, check=False
    ).stdout
    found: dict[str, str] = {}
    for line in listed.splitlines():
        name, _, value = line.partition("=")
        name, value = name.rpartition(".")[2], value.strip("'")
        if name in {"index-url", "extra-index-url", "trusted-host", "proxy", "default-timeout"}:
            usable = [word for word in value.split() if not word.startswith("file:")]
            found[name] = " ".join(usable)
    return found


def of_npm() -> dict[str, str]:
    """Return how npm reaches its registry here."""
    if shutil.which("npm") is None:
        return {}
    names = ("registry", "proxy", "https-proxy")
    values = {
        name: subprocess.run(
            ["npm", "config", "get", name], capture_output=True, text=True, check=False, cwd="/"
        ).stdout.strip()
        for name in names
    }
    return {name: value for name, value in values.items() if value not in {"", "null", "undefined"}}


def written(path: Path, lines: list[str]) -> str:
    """Write a file that nobody else may read, and return where it is."""
    path.touch(mode=0o600)
    path.write_text("\n".join([*lines, ""]))
    return str(path)
