"""The compose file: what it starts is what there is, containers have their walls, little is published."""

import functools
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from dotenv import dotenv_values
from psycopg.conninfo import conninfo_to_dict

from glove_sdk_bridge.command_line import parse
from handover.broker.credentials import credentials_of
from handover.command_line.secrets import SECRETS
from handover.command_line.waiting import wait_for_secrets
from handover.security.glove_token import GLOVE_TOKEN_FILE
from handover.services import own_services
from handover.settings import Settings, origins
from handover_broker.settings import BrokerSettings
from handover_cell.secure import Plan
from handover_gloves.command_line.glove import bridge_arguments
from handover_web.settings import WebuiSettings
from requirements.subset import members, subset
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import scaled, wait_for

COMPOSE: dict[str, Any] = yaml.safe_load((REPOSITORY / "docker-compose.yml").read_text())
ENV = {name: value or "" for name, value in dotenv_values(REPOSITORY / ".env", interpolate=False).items()}
CONTAINERS: dict[str, dict[str, Any]] = COMPOSE["services"]
SERVICES = own_services()
OURS = {
    name: each for name, each in CONTAINERS.items() if each["image"].partition(":")[0].startswith("handover")
}
MEMBERS = members()
INIT = "init"
"""Ends once certificates, tokens, secrets and accounts are made."""
THIRD_PARTY = {name: each for name, each in CONTAINERS.items() if name not in OURS}
CHOSEN = {name for name in ENV["COMPOSE_PROFILES"].split(",") if name}
VARIABLE = re.compile(r"\$\{([A-Z_]+)(?::-([^}]*))?\}")

POSTGRES_START = REPOSITORY / "deploy" / "postgres-start"
DATABASE_URLS = {"HANDOVER_DATABASE_URL", "HANDOVER_BROKER_DATABASE_URL"}

every_container = pytest.mark.parametrize("name", CONTAINERS)
every_one_of_ours = pytest.mark.parametrize("name", OURS)


@functools.cache
def known_settings() -> set[str]:
    return {origin.name for origin in origins([service.settings for service in SERVICES])}


def texts(of: Any) -> list[str]:
    if isinstance(of, dict):
        return [text for value in of.values() for text in texts(value)]
    if isinstance(of, list):
        return [text for value in of for text in texts(value)]
    return [str(of)]


def test_every_service_of_the_command_line_has_a_container_of_its_name() -> None:
    run = {name: each["command"] for name, each in OURS.items() if each["command"][:2] == ["handover", "run"]}
    assert run == {service.name: ["handover", "run", "--watch", service.name] for service in SERVICES}


def test_the_simulated_operator_is_not_there_unless_it_is_chosen() -> None:
    assert OURS["simulated-operator"]["profiles"] == ["simulated-operator"]
    assert "simulated-operator" not in CHOSEN


def test_no_secret_is_printed_in_the_repository() -> None:
    for text in (*texts(COMPOSE), *ENV.values()):
        assert "public-until-changed" not in text
    for name in ("CELL_GLOVE_TOKEN", "CELL_DATABASE_PASSWORD", "CELL_HEALTH_RECORDING_KEY"):
        assert ENV[name] == ""
    assert "POSTGRES_PASSWORD" not in CONTAINERS["postgres"]["environment"]


def readers() -> dict[str, str]:
    """Return the volumes in which there are copies of secrets, with their folder in the first container."""
    targets = dict(mount.split(":")[:2] for mount in OURS[INIT]["volumes"])
    return {name: at for name, at in targets.items() if name.startswith("secret-")}


def given_to(mount: str) -> set[str]:
    """Return the secrets in the volume of a mount."""
    folder = readers()[mount.split(":", maxsplit=1)[0]]
    copied = plan_of(OURS[INIT]["command"][1:]).secrets
    return {name for at, names in copied if str(at) == folder for name in names}


def test_who_needs_a_secret_reads_it_from_a_file_and_depends_on_no_container_that_ends() -> None:
    for name, each in CONTAINERS.items():
        assert INIT not in each.get("depends_on", {}), "podman would never restart it"
        mounts = [mount for mount in each.get("volumes", []) if mount.startswith("secret")]
        said = each.get("environment", {})
        if name == INIT:
            assert set(mounts) == {
                "secrets:/secrets",
                *(f"{volume}:{at}" for volume, at in readers().items()),
            }
            assert said["HANDOVER_SECRETS_DIR"] == "/secrets"
        elif used := set(SECRETS) & set(said):
            assert said["HANDOVER_SECRETS_DIR"] == "/secrets"
            assert {secret for mount in mounts for secret in given_to(mount)} == used, (
                "what it uses and no more"
            )
            assert all(mount.endswith(":/secrets:ro") for mount in mounts)
            assert each["command"][:2] in (["handover", "run"], ["handover", "glove"]), "these wait for it"
        elif name == "postgres":
            assert given_to(*mounts) == {"HANDOVER_DATABASE_PASSWORD"}
            assert "/secrets/HANDOVER_DATABASE_PASSWORD" in POSTGRES_START.read_text()
        else:
            assert mounts == [], name


@every_one_of_ours
def test_a_container_waits_only_for_the_secrets_that_are_mounted_in_it(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    each = OURS[name]
    for variable, value in each.get("environment", {}).items():
        if variable in SECRETS:
            monkeypatch.setenv(variable, VARIABLE.sub(r"\2", value))
    monkeypatch.setenv("HANDOVER_SECRETS_DIR", str(tmp_path))
    for mount in each.get("volumes", []):
        for secret in given_to(mount) if mount.startswith("secret-") else ():
            (tmp_path / secret).write_text("x")
    for service in SERVICES:
        if each["command"][:2] == ["handover", "run"] and each["command"][-1] == service.name:
            wait_for_secrets(service.settings.model_fields, timeout_s=0)


def test_the_first_container_makes_what_is_secret_as_the_user_of_the_image() -> None:
    each = OURS[INIT]
    assert (each["entrypoint"], each["command"][0]) == (["handover"], "secure")
    assert each["restart"] == "no"
    assert "profiles" not in each
    assert next(iter(CONTAINERS)) == INIT, "podman gives an empty volume to the first user of it"
    targets = {mount.split(":")[1] for mount in each["volumes"]}
    folders = {
        each["environment"][f"HANDOVER_{name}_DIR"] for name in ("DATA", "AUTHORITY", "SECURITY", "SECRETS")
    }
    copies = {target for target in targets if target.startswith("/secrets-of/")}
    assert {target for target in targets - copies if not target.startswith("/tls/")} == folders
    dockerfile = (REPOSITORY / "Dockerfile").read_text().replace("\\\n", " ")
    made = [
        set(found.split())
        for found in re.findall(r"install -d -o handover -g handover -m 07\d\d ([^&\n]*)", dockerfile)
    ]
    assert made == [
        {*folders, "/secrets-of", *copies},
        {"/tls", *targets - folders - copies},
    ], "an empty volume gets the owner of the folder"


def test_each_service_has_a_certificate_of_its_name_and_a_token_of_its_own() -> None:
    plan = plan_of(OURS[INIT]["command"][1:])
    assert {str(folder): names[0] for folder, names in plan.servers} == {
        **{f"/tls/{service.name}": service.name for service in SERVICES},
        "/tls/other-broker": "other-broker",
        "/tls/postgres": "postgres",
    }
    assert plan.clients == ((Path("/tls/operator"), "cli"),)
    assert plan.trusting == (Path("/tls/clients"),)
    mounts = dict(reversed(mount.split(":")) for mount in OURS[INIT]["volumes"])
    folders = [folder for folder, _ in (*plan.servers, *plan.clients)] + list(plan.trusting)
    assert {mounts[str(folder)] for folder in folders} == {f"tls-{folder.name}" for folder in folders}
    assert plan.token_files() == {
        **{service.name: Path(f"/tls/{service.name}/service-token") for service in SERVICES},
        "cli": Path("/tls/operator/service-token"),
    }


def plan_of(words: list[str]) -> Plan:
    """Return what the arguments of the first container ask for, with nothing edited."""
    given: dict[str, list[str]] = {"--server": [], "--client": [], "--trust": [], "--secret": []}
    for word in words:
        option, _, value = word.partition("=")
        given[option].append(VARIABLE.sub(lambda met: ENV.get(met[1], met[2] or ""), value))
    return Plan.of(*given.values())


def test_a_container_mounts_its_own_certificate_and_token_alone() -> None:
    """Nobody but the first container mounts the key of the authority; only accounts writes public keys."""
    for name, each in CONTAINERS.items():
        mounts = [
            mount
            for mount in each.get("volumes", [])
            if mount.startswith(("tls-", "authority:", "security:"))
        ]
        said = each.get("environment", {})
        if name in {service.name for service in SERVICES}:
            mode = "" if name == "accounts" else ":ro"
            assert mounts == [f"tls-{name}:/tls:ro", f"security:/security{mode}"]
            assert said["HANDOVER_TLS_CERTIFICATE"] == "/tls/certificate.pem"
            assert said["HANDOVER_TLS_KEY"] == "/tls/key.pem"
        elif name == "simulated-operator":
            assert mounts == ["tls-operator:/tls:ro", "security:/security:ro"]
        elif name == "prometheus":
            assert mounts == ["tls-clients:/tls:ro"]
        elif name in {"other-broker", "postgres"}:
            assert mounts == [f"tls-{name}:/tls:ro"]
        else:
            assert name == INIT or mounts == []
        if mounts and "HANDOVER_SECURITY_DIR" in said and name != INIT:
            assert said["HANDOVER_TLS_AUTHORITY"] == "/tls/authority.pem"
            assert said["HANDOVER_SERVICE_TOKEN_FILE"] == "/tls/service-token"
            assert said["HANDOVER_SECURITY_DIR"] == "/security"


def test_what_all_services_mount_holds_no_secret(tmp_path: Path) -> None:
    """The first container makes everything in folders of this machine; `security` is in each service."""
    said = OURS[INIT]["environment"]
    folders = {name: f"{tmp_path}{said[name]}" for name in said if name.endswith("_DIR")}
    command = [word.replace("=/", f"={tmp_path}/") for word in OURS[INIT]["command"]]
    left = Path(folders["HANDOVER_SECURITY_DIR"]) / GLOVE_TOKEN_FILE
    left.parent.mkdir()
    left.write_text("of a start before secrets were files of their own")
    words = [VARIABLE.sub(lambda met: ENV.get(met[1], met[2] or ""), word) for word in command]
    done = subprocess.run(
        [sys.executable, "-m", "handover_cell", *words],
        env={**os.environ, **folders, "HANDOVER_WEBUI_URL": "https://127.0.0.1:54400"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert sorted(one.name for one in (tmp_path / "secrets").iterdir()) == sorted(SECRETS)
    secret = {one.read_text().strip() for one in (tmp_path / "secrets").iterdir()}
    secret |= {one.read_text().strip() for one in (tmp_path / "tls").glob("*/service-token")}
    assert len(secret) == len(SECRETS) + len(SERVICES) + 1
    shared = [one for one in (tmp_path / "security").rglob("*") if one.is_file()]
    assert shared
    for file in shared:
        content = file.read_text()
        assert not any(one in content for one in secret), file
        assert "PRIVATE" not in content, file
        assert file.name != GLOVE_TOKEN_FILE


@pytest.mark.parametrize(
    ("environment", "address"),
    [
        ({}, "https://127.0.0.1:54400"),
        ({"CELL_ADDRESS": "192.168.7.4", "CELL_UI_PORT": "443"}, "https://192.168.7.4:443"),
        ({"CELL_ADDRESS": "0.0.0.0"}, "https://127.0.0.1:54400"),
        ({"CELL_ADDRESS": "0.0.0.0", "CELL_HOSTS": "cell-3.example,cell-3"}, "https://cell-3.example:54400"),
    ],
)
def test_the_link_of_the_owner_leads_to_the_page(
    environment: dict[str, str], address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in OURS[INIT]["environment"].items():
        monkeypatch.setenv(
            name, VARIABLE.sub(lambda met: {**ENV, **environment}.get(met[1], met[2] or ""), value)
        )
    assert WebuiSettings.load(secrets_dir=None).public_url == address


def test_the_only_other_container_of_ours_is_an_operator_whom_the_bridge_understands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (other,) = set(OURS) - {service.name for service in SERVICES} - {INIT}
    for name, value in OURS[other]["environment"].items():
        monkeypatch.setenv(name, VARIABLE.sub(lambda met: ENV.get(met[1], met[2] or ""), value))
    words = OURS[other]["command"]
    assert words[:2] == ["handover", "glove"]
    asked = parse(bridge_arguments(words[2:]), "handover glove")
    assert (asked.command, asked.host, asked.port) == ("simulate", "gesture-controller", 54000)
    assert asked.tls
    assert asked.controller == "https://gesture-controller:54210"


@pytest.mark.parametrize("name", sorted(set(OURS) - {INIT}))
def test_the_health_check_asks_where_the_service_listens(name: str) -> None:
    test = OURS[name]["healthcheck"]["test"]
    assert test[:4] == ["CMD", "python", "-m", "handover.health"]
    ports = {service.name: service.settings.model_fields[service.port_field].default for service in SERVICES}
    expected = (
        f"https://127.0.0.1:{ports[name]}/readyz"
        if name in ports
        else (f"https://gesture-controller:{ports['gesture-controller']}/gloves/{OURS[name]['command'][-1]}")
    )
    assert test[4] == expected


def test_the_addresses_by_which_services_find_each_other_lead_to_containers() -> None:
    for service in SERVICES:
        if service.name == "context-broker":
            continue
        url = OURS[service.name]["environment"][service.port_setting.replace("_PORT", "_URL")]
        assert url == f"https://{service.name}:{service.settings.model_fields[service.port_field].default}"
    assert ENV["CELL_BROKER_URL"] == "https://context-broker:1026"


@pytest.mark.parametrize(
    ("given", "is_wanted"),
    [
        ({}, False),
        ({"CELL_BROKER_HEADERS": '{"X-Auth-Token": "secret"}'}, True),
        (
            {
                "CELL_BROKER_OAUTH_URL": "https://keyrock.example/oauth2/token",
                "CELL_BROKER_OAUTH_CLIENT": "cell",
                "CELL_BROKER_OAUTH_SECRET": "secret",
            },
            True,
        ),
    ],
)
@pytest.mark.parametrize(
    "name", [name for name in OURS if "HANDOVER_BROKER_URL" in OURS[name]["environment"]]
)
def test_each_service_gets_the_credentials_of_another_broker(
    name: str, given: dict[str, str], is_wanted: bool
) -> None:
    values = {
        key.removeprefix("HANDOVER_").lower(): VARIABLE.sub(lambda met: (ENV | given)[met[1]], text)
        for key, text in OURS[name]["environment"].items()
        if key.startswith("HANDOVER_BROKER_") and "DATABASE" not in key
    }
    assert (credentials_of(Settings.load(**values)) is not None) is is_wanted


@pytest.mark.parametrize("more", ["", "192.168.7.0/24,scada.example"])
def test_the_broker_may_connect_to_every_service_of_the_cell(more: str) -> None:
    given = OURS["context-broker"]["environment"]["HANDOVER_OUTBOUND_ALLOW"]
    allowed = VARIABLE.sub(lambda met: {"CELL_OUTBOUND_ALLOW": more}[met[1]], given)
    policy = BrokerSettings.load(host="0.0.0.0", outbound_allow=allowed).outbound_policy()
    assert policy.listens_beyond_loopback
    others = {service.name for service in SERVICES if service.name != "context-broker"}
    assert policy.hosts == others | ({"scada.example"} if more else set())
    assert len(policy.networks) == bool(more)


@every_one_of_ours
def test_environment_of_a_container_has_known_settings_only(name: str) -> None:
    assert set(OURS[name]["environment"]) <= known_settings()


def test_three_ports_are_published_and_on_this_machine_alone() -> None:
    published = {name: each["ports"] for name, each in CONTAINERS.items() if "ports" in each}
    assert published.pop("grafana") == ["127.0.0.1:${CELL_GRAFANA_PORT:-54490}:3000"]
    assert published == {
        "gesture-controller": ["${CELL_ADDRESS:-127.0.0.1}:${CELL_GLOVE_PORT:-54000}:54000"],
        "device-gateway": ["${CELL_DEVICE_ADDRESS:-127.0.0.1}:${CELL_DEVICE_PORT:-54010}:54010"],
        "webui": ["${CELL_ADDRESS:-127.0.0.1}:${CELL_UI_PORT:-54400}:54400"],
    }
    assert ENV["CELL_ADDRESS"] == ENV["CELL_DEVICE_ADDRESS"] == "127.0.0.1"
    assert not CHOSEN & set(CONTAINERS["grafana"]["profiles"])


@every_container
def test_a_container_is_watched_limited_and_comes_back(name: str) -> None:
    each = CONTAINERS[name]
    assert each["init"] is True
    assert each["security_opt"] == ["no-new-privileges:true"]
    if name != INIT:
        assert each["restart"] == "unless-stopped"
        assert each["healthcheck"]["test"][0] == "CMD"
        assert {"interval", "timeout", "retries", "start_period"} < set(each["healthcheck"])
    assert set(each["deploy"]["resources"]["limits"]) == {"cpus", "memory", "pids"}
    assert each["logging"]["options"] == {"max-size": "10m", "max-file": "3"}
    assert each["networks"] == ["cell"]


@every_one_of_ours
def test_a_container_of_ours_has_nothing_it_does_not_need(name: str) -> None:
    each = OURS[name]
    assert each["read_only"] is True
    assert each["cap_drop"] == ["ALL"]
    assert [mount.split(":")[0] for mount in each["tmpfs"]] == ["/tmp"]
    assert "user" not in each, "the image has one"
    assert "privileged" not in each


@pytest.mark.parametrize("name", sorted(OURS.keys() - {INIT, "ros-bridge"}))
def test_a_container_has_the_image_of_its_distribution(name: str) -> None:
    container = OURS[name]
    distribution = container["build"]["args"]["DISTRIBUTION"]
    project, _, extras = distribution.removesuffix("]").partition("[")
    assert container["image"].split(":")[0] == project
    known = MEMBERS[project]["project"].get("optional-dependencies", {})
    assert set(filter(None, extras.split(","))) <= known.keys()
    *_, last = container["command"]
    if container["command"][:2] == ["handover", "run"]:
        assert last in MEMBERS[project]["project"]["entry-points"]["handover.services"]


def test_the_release_and_the_cluster_have_the_same_images() -> None:
    ours = {OURS[name]["build"]["args"]["DISTRIBUTION"] for name in OURS.keys() - {INIT, "ros-bridge"}}
    workflow = yaml.safe_load((REPOSITORY / ".github/workflows/release.yml").read_text())
    released = {
        image["distribution"]
        for job in workflow["jobs"].values()
        for image in job.get("strategy", {}).get("matrix", {}).get("include", [])
    }
    assert released == ours | {"handover-cell", "handover-ros"}
    (parts,) = re.findall(r"for part in (.*); do", (REPOSITORY / "deploy/kubernetes/README.md").read_text())
    cluster = {f"handover-{part}" for part in parts.replace('"', "").split()}
    assert cluster == {name for name in ours if not name.startswith("handover-robots")}


def test_the_image_with_motion_and_physics_can_plan_and_simulate() -> None:
    packages = subset([OURS["trajectory-tool"]["build"]["args"]["DISTRIBUTION"]])
    assert all(re.search(rf"^{name}==", packages, re.MULTILINE) for name in ("coal", "ompl", "mujoco-core"))
    dockerfile = (REPOSITORY / "Dockerfile").read_text()
    for stage in ("requirements", "install"):
        assert f"AS {stage}\nARG DISTRIBUTION\n" in dockerfile, "an argument ends with its stage"


def test_the_image_runs_as_nobody_of_importance() -> None:
    dockerfile = (REPOSITORY / "Dockerfile").read_text()
    last_stage = dockerfile.rsplit("\nFROM ", 1)[1]
    assert re.search(r"^USER (\d+):(\d+)$", last_stage, re.MULTILINE)
    assert set(re.findall(r"^FROM (\S+)", dockerfile, re.MULTILINE)) == {"${BASE}", "build"}
    assert "ARG BASE=python:3.12-slim\n" in dockerfile


def test_the_image_with_ros_runs_as_nobody_of_importance_and_keeps_what_sources_ros() -> None:
    build = OURS["ros-bridge"]["build"]
    dockerfile = (REPOSITORY / build["dockerfile"]).read_text()
    last_stage = dockerfile.rsplit("\nFROM ", 1)[1]
    assert re.search(r"^USER (\d+):(\d+)$", last_stage, re.MULTILINE)
    assert 'ENTRYPOINT ["/ros_entrypoint.sh"]' in last_stage
    assert set(re.findall(r"^FROM (\S+)", dockerfile, re.MULTILINE)) == {"${BASE}"}
    assert "ARG BASE=ros:jazzy-ros-base\n" in dockerfile
    for copied in re.findall(r"^COPY (requirements/.*) requirements/$", dockerfile, re.MULTILINE):
        for file in copied.split():
            assert (REPOSITORY / file).exists(), file


def test_the_ros_bridge_is_there_only_where_it_is_chosen_with_numpy_as_jazzy_has_it() -> None:
    assert OURS["ros-bridge"]["profiles"] == ["ros"]
    assert ENV.get("CELL_ROS_MAPPING", "") == ""
    assert "\nnumpy==1.26." in (REPOSITORY / "requirements" / "jazzy.lock").read_text()


@every_container
def test_nobody_waits_for_what_may_not_be_there(name: str) -> None:
    """podman-compose cannot wait for a service whose profile is not chosen."""
    for other, how in CONTAINERS[name].get("depends_on", {}).items():
        assert how == {"condition": "service_healthy"}
        assert set(CONTAINERS[other].get("profiles", [])) <= set(CONTAINERS[name].get("profiles", []))


def test_nothing_of_others_starts_unless_it_is_chosen() -> None:
    assert sorted(CHOSEN) == ["embedded-broker"]
    for name, each in THIRD_PARTY.items():
        assert each["profiles"], name
        assert not CHOSEN & set(each["profiles"])


def test_the_two_brokers_are_never_chosen_together_by_a_default() -> None:
    assert CONTAINERS["context-broker"]["profiles"] == ["embedded-broker"]
    assert CONTAINERS["orion"]["profiles"] == CONTAINERS["mongo"]["profiles"] == ["orion"]
    assert CONTAINERS["scorpio"]["profiles"] == CONTAINERS["scorpio-postgres"]["profiles"] == ["scorpio"]
    assert CONTAINERS["other-broker"]["profiles"] == ["orion", "scorpio", "other-broker"]


def test_the_proxy_of_a_broker_of_others_has_its_certificate_and_no_token() -> None:
    each = CONTAINERS["other-broker"]
    assert "tls-other-broker:/tls:ro" in each["volumes"]
    assert "other-broker" not in plan_of(OURS[INIT]["command"][1:]).token_files()
    (script,) = each["entrypoint"][2:]
    written = (REPOSITORY / "deploy/other-broker.conf").read_text()
    placeholders = set(re.findall(r"\b[A-Z]{4,}\b", re.sub(r"(?m)^\s*#.*", "", written)))
    assert placeholders == set(re.findall(r"s\|(\w+)\|", script))
    assert "listen 1026 ssl" in written
    assert "proxy_ssl_verify on" in written


def documented_databases() -> set[str]:
    """Return the URLs of the database of the profile `postgres` in the documents and settings."""
    files = [REPOSITORY / ".env", REPOSITORY / "deploy" / "README.md"]
    files += (REPOSITORY / "deploy" / "kubernetes").glob("*.yaml")
    return {
        url for file in files for url in re.findall(r"postgresql://handover@postgres/\S*", file.read_text())
    }


def test_every_url_of_the_database_of_the_cell_demands_its_certificate_and_the_right_name() -> None:
    urls = documented_databases()
    assert urls
    for url in urls:
        options = conninfo_to_dict(url)
        assert (options["sslmode"], options["sslrootcert"]) == ("verify-full", "/tls/authority.pem"), url
    servers = dict(plan_of(OURS[INIT]["command"][1:]).servers)
    assert servers[Path("/tls/postgres")] == (conninfo_to_dict(next(iter(urls)))["host"],)
    users = [each for each in OURS.values() if set(each["environment"]) & DATABASE_URLS]
    assert all(any(mount.endswith(":/tls:ro") for mount in each["volumes"]) for each in users)


@pytest.mark.nightly
def test_postgresql_starts_with_its_certificate_and_loads_a_renewed_one(tmp_path: Path) -> None:
    """The script of the container runs with folders of this machine, and a program in place of the image."""
    each = CONTAINERS["postgres"]
    assert each["entrypoint"] == ["bash", "/postgres-start"]
    assert "./deploy/postgres-start:/postgres-start:ro" in each["volumes"]
    for name in ("tls", "secrets", "bin"):
        (tmp_path / name).mkdir()
    (tmp_path / "secrets" / "HANDOVER_DATABASE_PASSWORD").write_text("secret")
    (tmp_path / "tls" / "key.pem").write_text("key")
    (tmp_path / "tls" / "certificate.pem").write_text("first")
    image = tmp_path / "bin" / "docker-entrypoint.sh"
    image.write_text(
        '#!/bin/bash\ncd "$(dirname "$0")/.."\ntrap "cat own/certificate.pem >>loaded" HUP\n'
        'echo "$POSTGRES_PASSWORD $*" >started.new\nmv started.new started\n'
        "while [[ ! -e end ]]; do sleep 0.1; done\n"
    )
    image.chmod(0o755)
    text = POSTGRES_START.read_text()
    for known, here in (
        ("/etc/postgresql-tls", f"{tmp_path}/own"),
        ("/tls/", f"{tmp_path}/tls/"),
        ("/secrets/", f"{tmp_path}/secrets/"),
        (" -o postgres -g postgres", ""),
        ("sleep 60", "sleep 0.1"),
    ):
        assert known in text
        text = text.replace(known, here)
    (tmp_path / "start").write_text(text)
    environment = {**os.environ, "PATH": f"{image.parent}:{os.environ['PATH']}"}

    def loads_the_second() -> bool:
        loaded = tmp_path / "loaded"
        return loaded.exists() and "second" in loaded.read_text()

    command = ["env", "--default-signal=HUP", "bash", str(tmp_path / "start"), "postgres"]  # also under nohup
    process = subprocess.Popen(command, env=environment)
    try:
        wait_for((tmp_path / "started").exists, 30)
        said = (tmp_path / "started").read_text()
        assert said.startswith("secret postgres -c ssl=on")
        for file in re.findall(r"ssl_\w+_file=(\S+)", said):
            assert Path(file).stat().st_mode & 0o777 == 0o600
        (tmp_path / "tls" / "certificate.pem").write_text("second")
        wait_for(loads_the_second, 30)
    finally:
        (tmp_path / "end").touch()
        process.wait(scaled(30))


def test_orion_starts_with_a_present_mongodb_keeps_lists_and_does_not_fill_the_disk() -> None:
    command = CONTAINERS["orion"]["command"]
    assert {"-mongocOnly", "-noArrayReduction"} <= set(command)
    assert command[command.index("-logLevel") + 1] == "ERROR"
    assert CONTAINERS["orion"]["deploy"]["resources"]["limits"]["memory"]


def test_every_variable_has_a_value_with_nothing_edited() -> None:
    for text in texts(CONTAINERS):
        for name, default in VARIABLE.findall(text):
            assert name.startswith("CELL_"), name
            assert default or name in ENV, f"{name} has no value"
            assert default == ENV.get(name, default), f"{name} has two defaults"


def test_what_can_be_set_is_used_and_explained() -> None:
    used = {name for text in texts(CONTAINERS) for name, _ in VARIABLE.findall(text)}
    explained = (REPOSITORY / "deploy" / "README.md").read_text()
    for name in ENV:
        assert name in used | {"COMPOSE_PROFILES"}, f"{name} sets nothing"
    for name in used | set(ENV):
        assert f"`{name}`" in explained, f"deploy/README.md says nothing of {name}"


def test_a_service_that_runs_here_without_a_container_is_not_changed_by_the_containers_settings() -> None:
    """`handover` reads `.env` of the folder it is started in as well."""
    assert not [name for name in ENV if name.startswith("HANDOVER_")]


def test_every_volume_is_declared_and_used() -> None:
    mounted = {
        mount.split(":")[0]
        for each in CONTAINERS.values()
        for mount in each.get("volumes", [])
        if not mount.startswith("./")
    }
    assert mounted == set(COMPOSE["volumes"])
    keeping = {name for name, each in OURS.items() if each.get("volumes")}
    assert keeping == {service.name for service in SERVICES} | {INIT, "simulated-operator"}


def test_every_file_that_is_mounted_is_there() -> None:
    for each in CONTAINERS.values():
        for mount in each.get("volumes", []):
            if mount.startswith("./"):
                assert (REPOSITORY / mount.split(":")[0]).exists(), mount
                assert mount.endswith(":ro")
