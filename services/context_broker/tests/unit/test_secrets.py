"""Addresses are shown without their secrets, and stay recognizable."""

import pytest

from handover_broker.model.secrets import HIDDEN, without_secrets


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("http://user:s3cret@host/n", f"http://{HIDDEN}@host/n"),
        ("http://host/n?token=s3cret&more=s3cret", f"http://host/n?token={HIDDEN}&more={HIDDEN}"),
        ("http://host/n?s3cret", f"http://host/n?{HIDDEN}"),
        ("http://host/n?a=1&s3cret", f"http://host/n?a={HIDDEN}&{HIDDEN}"),
        ("http://host/n#token=s3cret", f"http://host/n#{HIDDEN}"),
        ("http://host/n#s3cret", f"http://host/n#{HIDDEN}"),
        ("https://api.bot/bot110201543:AAHdqTcvCH1vGWJxfSeofSAs0K5PALDsaw/send", f"https://api.bot/{HIDDEN}/send"),
        ("https://host/AbCd+123456789012345/x", f"https://host/{HIDDEN}/x"),
        ("https://host//k3y-with-20-characters", f"https://host//{HIDDEN}"),
        ("https://human-state-1.handover.svc.cluster.local/n", "https://human-state-1.handover.svc.cluster.local/n"),
        ("https://human-state-1.handover.svc.cluster.local", "https://human-state-1.handover.svc.cluster.local"),
        ("http://127.0.0.1:1026/ngsi-ld/v1/notify", "http://127.0.0.1:1026/ngsi-ld/v1/notify"),
        ("mqtt://user:s3cret@host:1883/cell/state", f"mqtt://{HIDDEN}@host:1883/cell/state"),
        ("http://host/urn:ngsi-ld:Device:demo:ur10-1", "http://host/urn:ngsi-ld:Device:demo:ur10-1"),
        ("urn:ngsi-ld:Device:demo:ur10-1", "urn:ngsi-ld:Device:demo:ur10-1"),
    ],
)  # fmt: skip
def test_secrets_of_an_address_are_hidden_and_nothing_else(address: str, shown: str) -> None:
    assert without_secrets(address) == shown
    assert without_secrets(shown) == shown, "what was read can be sent back"
