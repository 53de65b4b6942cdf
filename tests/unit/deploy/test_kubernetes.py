"""The manifests for Kubernetes: valid by its schemas, without privileges, and with settings that exist."""

import functools
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from handover.services import own_services
from handover.settings import origins
from tests.kit import processes
from tests.kit.paths import REPOSITORY

FOLDER = REPOSITORY / "deploy/kubernetes"
KUSTOMIZATION: dict[str, Any] = yaml.safe_load((FOLDER / "kustomization.yaml").read_text())
SERVICES = own_services()
DOCUMENTS: list[dict[str, Any]] = [
    document
    for name in KUSTOMIZATION["resources"]
    for document in yaml.safe_load_all((FOLDER / name).read_text())
]
WORKLOADS = {
    document["metadata"]["name"]: document
    for document in DOCUMENTS
    if document["kind"] in {"Deployment", "StatefulSet"}
}
OURS = {name: each for name, each in WORKLOADS.items() if name != "postgres"}
KNOWN = {service.name: service for service in SERVICES}
SETTINGS = next(document for document in DOCUMENTS if document["kind"] == "ConfigMap")["data"]

every_workload = pytest.mark.parametrize("name", WORKLOADS)
every_one_of_ours = pytest.mark.parametrize("name", OURS)


@functools.cache
def known_settings() -> set[str]:
    return {origin.name for origin in origins([service.settings for service in SERVICES])}


def pod_of(name: str) -> dict[str, Any]:
    pod: dict[str, Any] = WORKLOADS[name]["spec"]["template"]["spec"]
    return pod


def container_of(name: str) -> dict[str, Any]:
    (container,) = pod_of(name)["containers"]
    return dict(container)


def named(kind: str) -> dict[str, dict[str, Any]]:
    return {each["metadata"]["name"]: each for each in DOCUMENTS if each["kind"] == kind}


def test_every_file_is_part_of_the_cell() -> None:
    files = {path.name for path in FOLDER.glob("*.yaml")} - {"kustomization.yaml"}
    assert files == set(KUSTOMIZATION["resources"])


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda each: f"{each['kind']}-{each['metadata']['name']}")
def test_each_document_is_valid_by_the_schema_of_kubernetes(document: dict[str, Any]) -> None:
    kubernetes_validate.validate(document, "1.31", strict=True)
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate({**document, "surplus": 1}, "1.31", strict=True)


@every_workload
def test_a_pod_has_no_privileges_and_a_read_only_file_system(name: str) -> None:
    pod, container = pod_of(name), container_of(name)
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert pod["securityContext"]["runAsUser"] > 0
    assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert pod["automountServiceAccountToken"] is False
    assert container["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    assert container["resources"]["limits"]["memory"]
    assert container["resources"]["requests"]["cpu"]
    assert {"livenessProbe", "readinessProbe"} <= set(container)


@every_one_of_ours
def test_a_service_runs_with_settings_that_exist_and_is_asked_where_it_listens(name: str) -> None:
    container, service = container_of(name), KNOWN[name]
    assert container["command"] == ["handover", "run", "--watch", name]
    given = {one["name"] for one in container.get("env", ())} | set(SETTINGS)
    assert given <= known_settings()
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    assert ports["https"] == service.settings.model_fields[service.port_field].default
    for probe, path in (("livenessProbe", "/healthz"), ("readinessProbe", "/readyz")):
        asked = container[probe]["httpGet"]
        assert (asked["path"], asked["port"], asked["scheme"]) == (path, "https", "HTTPS")


def test_services_lead_to_pods_and_to_ports_that_they_have() -> None:
    for service in named("Service").values():
        labels = service["spec"]["selector"]
        (workload,) = (
            name
            for name, each in WORKLOADS.items()
            if labels.items() <= each["spec"]["template"]["metadata"]["labels"].items()
        )
        ports = {port["name"] for port in container_of(workload)["ports"]}
        assert {port["targetPort"] for port in service["spec"]["ports"]} <= ports


def test_only_page_gloves_and_devices_are_reached_from_outside() -> None:
    outside = {name for name, each in named("Service").items() if each["spec"].get("type") == "LoadBalancer"}
    assert outside == {"webui", "gloves", "devices"}
    policies = named("NetworkPolicy")
    assert policies["nothing"]["spec"] == {"podSelector": {}, "policyTypes": ["Ingress", "Egress"]}
    open_ports = {
        port["port"]
        for policy in policies.values()
        for rule in policy["spec"].get("ingress", ())
        if "from" not in rule
        for port in rule["ports"]
    }
    assert open_ports == {54400, 54000, 54010}


def test_what_scales_has_replicas_a_budget_and_a_workload() -> None:
    for name, scaler in named("HorizontalPodAutoscaler").items():
        target = scaler["spec"]["scaleTargetRef"]
        assert WORKLOADS[target["name"]]["kind"] == target["kind"]
        assert WORKLOADS[name]["spec"]["replicas"] == scaler["spec"]["minReplicas"] >= 2
        labels = WORKLOADS[name]["spec"]["template"]["metadata"]["labels"]
        assert named("PodDisruptionBudget")[name]["spec"]["selector"]["matchLabels"] == labels
    single = {name for name, each in OURS.items() if each["spec"]["replicas"] == 1}
    assert all(WORKLOADS[name]["spec"]["strategy"] == {"type": "Recreate"} for name in single)


def test_the_broker_may_notify_each_replica_of_the_page() -> None:
    most = named("HorizontalPodAutoscaler")["webui"]["spec"]["maxReplicas"]
    (allowed,) = (
        one["value"]
        for one in container_of("context-broker")["env"]
        if one["name"] == "HANDOVER_OUTBOUND_ALLOW"
    )
    assert {f"webui-{number}.webui-replicas" for number in range(most)} <= set(allowed.split(","))


@pytest.mark.nightly
def test_the_script_makes_every_file_of_the_secrets(tmp_path: Path) -> None:
    """It is run on a copy, with a database of its own."""
    (tmp_path / "secure").write_bytes((FOLDER / "secure").read_bytes())
    environment = processes.clean_environment() | {
        "HANDOVER": str(Path(sys.executable).with_name("handover")),
        "HANDOVER_DATABASE_URL": f"sqlite:///{tmp_path / 'accounts.db'}",
    }
    done = subprocess.run(
        ["bash", str(tmp_path / "secure"), "handover.example"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    assert "https://handover.example/join#" in done.stdout
    secrets = {one["name"]: one["files"] for one in KUSTOMIZATION["secretGenerator"]}
    for files in secrets.values():
        for file in files:
            assert (tmp_path / file).is_file(), file
    assert {one for name in WORKLOADS for one in secrets_of(name)} == set(secrets)


def test_postgresql_has_tls_with_the_files_of_its_secret() -> None:
    options = " ".join(container_of("postgres")["args"])
    assert "-c ssl=on" in options
    files = {Path(file) for file in re.findall(r"ssl_\w+_file=(\S+)", options)}
    (secret,) = (one["files"] for one in KUSTOMIZATION["secretGenerator"] if one["name"] == "tls-postgres")
    assert {file.name for file in files} == {Path(file).name for file in secret}
    (mount,) = (one for one in container_of("postgres")["volumeMounts"] if one["name"] == "tls")
    assert {str(file.parent) for file in files} == {mount["mountPath"]}


def secrets_of(name: str) -> set[str]:
    """Return the names of the secrets that a pod can read."""
    volumes = pod_of(name)["volumes"]
    projected = [one["secret"] for each in volumes for one in each.get("projected", {}).get("sources", ())]
    return {one["secret"]["secretName"] for one in volumes if "secret" in one} | {
        one["name"] for one in projected
    }


def test_each_pod_has_the_private_files_of_no_other() -> None:
    for name in OURS:
        own = {"handover-secrets", "public-keys", f"tls-{name}"}
        more = {"accounts": {"signing-keys"}, "human-state": {"recording-key"}}
        assert secrets_of(name) <= own | more.get(name, set()), name
    assert "recording-key" in secrets_of("human-state")
