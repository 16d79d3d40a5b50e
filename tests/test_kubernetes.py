"""deploy/kubernetes: every document is one that Kubernetes takes, and what they say fits together and to the code."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from common.config.sources import load
from reskpn import cli, health
from scripts.document_environment import OWN, passed_on

Document = dict[str, Any]

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "deploy" / "kubernetes"
BASE = FOLDER / "base"
OVERLAYS = sorted((FOLDER / "overlays").iterdir())
VERSIONS = ("1.30", "1.37")
"""Of Kubernetes: an old one that is still met, and the newest whose schemas are here."""

CERTIFICATES = "RESKPN_TRANSPORT__CERTIFICATES"
NAME = "app.kubernetes.io/name"
PART = "app.kubernetes.io/part-of"
WELL = health.Health(True, "")
SERVICES = ("learner", "actor", "evaluator")


def read(path: Path) -> list[Document]:
    return [document for document in yaml.safe_load_all(path.read_text()) if document is not None]


def kustomization(folder: Path) -> Document:
    (found,) = read(folder / "kustomization.yaml")
    return found


def resources(folder: Path) -> list[Document]:
    """Of a folder's own files."""
    names = [name for name in kustomization(folder)["resources"] if (folder / name).is_file()]
    return [document for name in names for document in read(folder / name)]


def merged(folder: Path) -> list[Document]:
    """The base with an overlay over it, as far as these overlays go: settings put over, and values replaced."""
    documents = copy.deepcopy(resources(BASE))
    for patch in kustomization(folder)["patches"]:
        if "path" in patch:
            (over,) = read(folder / patch["path"])
            one(documents, over["kind"], over["metadata"]["name"])["data"].update(over["data"])
            continue
        target = one(documents, patch["target"]["kind"], patch["target"]["name"])
        for change in yaml.safe_load(patch["patch"]):
            assert change["op"] == "replace"
            replace(target, change["path"].split("/")[1:], change["value"])
    return documents


def replace(document: Any, path: list[str], value: Any) -> None:
    """KeyError or IndexError where there is nothing to replace."""
    for step in path[:-1]:
        document = document[int(step)] if isinstance(document, list) else document[step]
    assert path[-1] in document
    document[path[-1]] = value


def one(documents: list[Document], kind: str, name: str) -> Document:
    (found,) = [d for d in documents if (d["kind"], d["metadata"]["name"]) == (kind, name)]
    return found


def workloads(documents: list[Document]) -> dict[str, Document]:
    """By service."""
    kinds = {"learner": "StatefulSet", "actor": "Deployment", "evaluator": "Deployment"}
    return {service: one(documents, kind, f"reskpn-{service}") for service, kind in kinds.items()}


def container(workload: Document) -> Document:
    (found,) = workload["spec"]["template"]["spec"]["containers"]
    return dict(found)


def environment(documents: list[Document], service: str) -> dict[str, str]:
    """The settings that its container has."""
    found = container(workloads(documents)[service])
    (source,) = found["envFrom"]
    given = dict(one(documents, "ConfigMap", source["configMapRef"]["name"])["data"])
    return given | {variable["name"]: variable["value"] for variable in found["env"]}


def everything() -> Iterator[Any]:
    for path in sorted(FOLDER.rglob("*.yaml")):
        if path.name != "kustomization.yaml":
            for document in read(path):
                yield pytest.param(document, id=f"{path.relative_to(FOLDER)}:{document['kind']}")
    for folder in OVERLAYS:
        for document in merged(folder):
            yield pytest.param(document, id=f"{folder.name} merged:{document['metadata']['name']}:{document['kind']}")


@pytest.fixture(params=[BASE, *OVERLAYS], ids=lambda folder: folder.name)
def documents(request: pytest.FixtureRequest) -> list[Document]:
    return resources(BASE) if request.param == BASE else merged(request.param)


@pytest.mark.parametrize("document", list(everything()))
@pytest.mark.parametrize("version", VERSIONS)
def test_kubernetes_takes_it(document: Document, version: str) -> None:
    """By its published schema, in which no field is unknown."""
    kubernetes_validate.validate(document, version, strict=True)


def test_the_check_can_fail() -> None:
    """A misspelt field is found."""
    wrong = copy.deepcopy(one(resources(BASE), "Deployment", "reskpn-actor"))
    wrong["spec"]["template"]["spec"]["containers"][0]["imagePullPolice"] = "Always"
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(wrong, VERSIONS[-1], strict=True)


@pytest.mark.parametrize("folder", [BASE, *OVERLAYS], ids=lambda folder: folder.name)
def test_every_file_is_used(folder: Path) -> None:
    """By its kustomization, which names none that is not there."""
    found = kustomization(folder)
    named = [*found["resources"], *(patch["path"] for patch in found.get("patches", []) if "path" in patch)]
    assert all((folder / name).exists() for name in named)
    assert {path.name for path in folder.glob("*.yaml")} - {"kustomization.yaml"} <= set(named)


def test_images_are_renamed_together() -> None:
    """What an overlay calls the image is put in place of a name that the containers have."""
    used = {container(workload)["image"].partition(":")[0] for workload in workloads(resources(BASE)).values()}
    for folder in OVERLAYS:
        assert {image["name"] for image in kustomization(folder)["images"]} == used


def test_selectors_select_their_own_pods(documents: list[Document]) -> None:
    """Each workload its template's, each of another name; all of them are parts of the whole."""
    for service, workload in workloads(documents).items():
        labels = workload["spec"]["template"]["metadata"]["labels"]
        assert labels == {NAME: f"reskpn-{service}", PART: "reskpn"}
        assert workload["spec"]["selector"]["matchLabels"].items() <= labels.items()


def test_followers_find_the_learner(documents: list[Document]) -> None:
    """The service's name and port are those that they are given, and lead to the port that the learner listens on."""
    service = one(documents, "Service", "reskpn-learner")
    learner = workloads(documents)["learner"]
    (port,) = service["spec"]["ports"]
    (listening,) = container(learner)["ports"]
    assert service["spec"]["selector"].items() <= learner["spec"]["template"]["metadata"]["labels"].items()
    assert port["targetPort"] == listening["name"]
    assert learner["spec"]["serviceName"] == service["metadata"]["name"]
    endpoint = environment(documents, "learner")["RESKPN_TRANSPORT__ENDPOINT"]
    assert endpoint == f"tls/0.0.0.0:{listening['containerPort']}"
    for follower in ("actor", "evaluator"):
        given = environment(documents, follower)["RESKPN_TRANSPORT__ENDPOINT"]
        assert given == f"tls/{service['metadata']['name']}:{port['port']}"


def test_the_settings_are_possible(documents: list[Document]) -> None:
    """Each variable is a setting, each value is taken, and nothing opens the learner to who has no certificate."""
    known = {line for line in passed_on().splitlines() if line.startswith("RESKPN_")} | OWN
    for service in SERVICES:
        given = environment(documents, service)
        assert set(given) <= known
        mounts = {
            mount["name"]: mount["mountPath"] for mount in container(workloads(documents)[service])["volumeMounts"]
        }
        assert given[CERTIFICATES] == mounts["certificates"]
        settings = load(environment=given)
        assert settings.transport.insecure is False
        assert str(settings.run_dir).startswith("/data/runs/")


def test_commands_are_those_there_are(documents: list[Document], monkeypatch: pytest.MonkeyPatch) -> None:
    """With the options that they are given, parsed up to the work itself."""
    called: list[str] = []
    for service in SERVICES:
        name = f"services.{service}.service.run_{service}"
        monkeypatch.setattr(name, lambda *_, service=service, **__: called.append(service) or 0)
    monkeypatch.setattr("reskpn.commands.learner.run_to_resume", lambda _: None)
    for service in SERVICES:
        assert cli.main(container(workloads(documents)[service])["args"]) == 0
    assert called == list(SERVICES)


def test_probes_ask_the_right_thing(documents: list[Document], monkeypatch: pytest.MonkeyPatch) -> None:
    """Followers: of the file that they are told to keep. Learner: at its own port for health checks."""
    for service, workload in workloads(documents).items():
        found = container(workload)
        probes = [found[name] for name in ("startupProbe", "livenessProbe", "readinessProbe") if name in found]
        assert len(probes) >= 2
        for probe in probes:
            command = probe["exec"]["command"]
            assert command[:4] == ["python", "-m", "reskpn.health", service]
            # A health check loads Python and Zenoh: more than the second that is the default.
            assert probe["timeoutSeconds"] >= 10
            if service == "learner":
                values = {variable["name"]: variable.get("value") for variable in found["env"]}
                # A learner that resumes for long must not be killed for it, and is not ready meanwhile.
                ready = ["--ready"] if probe is found["readinessProbe"] else []
                assert command[4:] == ["--port", values["RESKPN_TRANSPORT__HEALTH_PORT"], *ready]
                continue
            kept: list[Path] = []
            monkeypatch.setattr(health, "follower_health", lambda _, file, kept=kept: kept.append(file) or WELL)
            assert health.main(command[3:]) == 0
            assert str(kept[0]) == found["args"][found["args"].index("--state-file") + 1]


def test_pods_can_do_no_more_than_they_need(documents: list[Document]) -> None:
    """The image's own user, no capability, no token; what they write to is mounted, all else read-only."""
    (uid,) = re.findall(r"--uid (\d+)", (ROOT / "Dockerfile").read_text())
    for workload in workloads(documents).values():
        pod, found = workload["spec"]["template"]["spec"], container(workload)
        assert pod["automountServiceAccountToken"] is False
        assert pod["securityContext"]["runAsNonRoot"] is True
        assert {pod["securityContext"][name] for name in ("runAsUser", "runAsGroup", "fsGroup")} == {int(uid)}
        confined = found["securityContext"]
        assert confined["capabilities"] == {"drop": ["ALL"]}
        assert (confined["readOnlyRootFilesystem"], confined["allowPrivilegeEscalation"]) == (True, False)
        claims = [claim["metadata"]["name"] for claim in workload["spec"].get("volumeClaimTemplates", [])]
        volumes = {volume["name"]: volume for volume in pod["volumes"]}
        mounts = {mount["name"]: mount for mount in found["volumeMounts"]}
        assert sorted(mounts) == sorted([*volumes, *claims])
        assert {mounts[name]["mountPath"] for name in ("tmp", "cache")} == {"/tmp", "/cache"}
        assert mounts["certificates"]["readOnly"] is True
        assert volumes["certificates"]["secret"]["defaultMode"] == 0o440
        assert found["resources"]["requests"].keys() >= {"cpu", "memory"}
        assert "memory" in found["resources"]["limits"]


def test_the_run_outlives_its_pod(documents: list[Document]) -> None:
    """One learner, its runs on a claim, and time to close its log."""
    learner = workloads(documents)["learner"]
    assert learner["spec"]["replicas"] == 1
    assert {claim["metadata"]["name"] for claim in learner["spec"]["volumeClaimTemplates"]} == {"runs", "cache"}
    mounts = {mount["name"]: mount["mountPath"] for mount in container(learner)["volumeMounts"]}
    assert mounts["runs"] == "/data/runs"
    assert learner["spec"]["template"]["spec"]["terminationGracePeriodSeconds"] >= 30
    assert container(learner)["args"][1:] == ["--resume", "auto"]


def test_no_more_actors_than_slots(documents: list[Document]) -> None:
    """The autoscaler is of the actors, alone decides their number, and keeps to what the run has work for."""
    scaler = one(documents, "HorizontalPodAutoscaler", "reskpn-actor")
    actor = workloads(documents)["actor"]
    target = scaler["spec"]["scaleTargetRef"]
    assert (target["apiVersion"], target["kind"], target["name"]) == ("apps/v1", "Deployment", "reskpn-actor")
    assert "replicas" not in actor["spec"]
    slots = int(environment(documents, "learner")["RESKPN_ACTORS"])
    assert 1 <= scaler["spec"]["minReplicas"] <= scaler["spec"]["maxReplicas"] == slots
    # A share of what is requested is a share of the time only where no more than that can be had.
    resources = container(actor)["resources"]
    assert resources["requests"]["cpu"] == resources["limits"]["cpu"]


def test_the_network_lets_through_what_is_needed(documents: list[Document]) -> None:
    """All are denied everything; followers may reach the learner's port, and the names; the learner reaches nobody."""
    deny, inward, outward = (
        one(documents, "NetworkPolicy", f"reskpn-{name}")["spec"]
        for name in ("default-deny", "to-learner", "from-followers")
    )
    assert deny == {"podSelector": {"matchLabels": {PART: "reskpn"}}, "policyTypes": ["Ingress", "Egress"]}
    (port,) = container(workloads(documents)["learner"])["ports"]
    (rule,) = inward["ingress"]
    to_learner, to_names = outward["egress"]
    assert inward["podSelector"]["matchLabels"] == {NAME: "reskpn-learner"}
    assert to_learner["to"] == [{"podSelector": {"matchLabels": {NAME: "reskpn-learner"}}}]
    assert rule["ports"] == to_learner["ports"] == [{"protocol": "TCP", "port": port["containerPort"]}]
    (source,) = rule["from"]
    for selector in (source["podSelector"], outward["podSelector"]):
        (expression,) = selector["matchExpressions"]
        assert (expression["key"], expression["operator"]) == (NAME, "In")
        assert set(expression["values"]) == {"reskpn-actor", "reskpn-evaluator", "reskpn-viewer"}
    assert {entry["port"] for entry in to_names["ports"]} == {53}
    assert outward["policyTypes"] == ["Egress"]
    assert inward["policyTypes"] == ["Ingress"]


def test_the_secrets_are_explained(documents: list[Document]) -> None:
    """Each that a pod mounts is made in docs/deployment.md."""
    page = (ROOT / "docs" / "deployment.md").read_text()
    for workload in workloads(documents).values():
        for volume in workload["spec"]["template"]["spec"]["volumes"]:
            if "secret" in volume:
                assert f"secret generic {volume['secret']['secretName']} --from-file=" in page
