"""The local authority: private files, and certificates that are kept, renewed and repaired."""

import stat
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography import x509

from handover.errors import UsageError
from handover.transport_security.local_authority import RENEWED_BEFORE, LocalAuthority, checked_name
from tests.kit.certificates import Certificates, serial_in


@pytest.fixture
def certificates(tmp_path: Path) -> Certificates:
    return Certificates(tmp_path)


def test_only_the_owner_reads_the_keys(certificates: Certificates) -> None:
    certificates.make("cell-3.example")
    files = [path for path in certificates.folder.rglob("*") if path.is_file()]
    assert {path.name for path in files} == {
        "authority.key", "authority.pem", "certificate.pem", "key.pem", "servers.json",
    }  # fmt: skip
    for path in files:
        is_private = "key" in path.name or path.name == "servers.json"
        assert stat.S_IMODE(path.stat().st_mode) == (0o600 if is_private else 0o644), path
    for folder in ("authority", "server"):
        assert stat.S_IMODE((certificates.folder / folder).stat().st_mode) == 0o700


def test_a_certificate_is_for_the_names_and_for_loopback(certificates: Certificates) -> None:
    made = certificates.make("Cell-3.example.", "192.168.1.20", "fd00::1")
    certificate = x509.load_pem_x509_certificate(made.certificate.read_bytes())
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["cell-3.example", "localhost"]
    assert [str(one) for one in names.get_values_for_type(x509.IPAddress)] == [
        "192.168.1.20", "fd00::1", "127.0.0.1", "::1",
    ]  # fmt: skip


def test_a_second_call_keeps_authority_and_certificate(certificates: Certificates) -> None:
    first = certificates.authority.secure(certificates.folder / "server", ["a.example"])
    before = {path: path.read_bytes() for path in certificates.folder.rglob("*") if path.is_file()}
    second = LocalAuthority(certificates.folder / "authority").secure(first.folder, ["a.example"])
    assert (first.is_new, second.is_new) == (True, False)
    assert {path: path.read_bytes() for path in certificates.folder.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("left", "is_new"), [(RENEWED_BEFORE + timedelta(days=1), False), (RENEWED_BEFORE, True)]
)
def test_a_certificate_near_its_end_is_made_again(
    certificates: Certificates, left: timedelta, is_new: bool
) -> None:
    made = certificates.make("a.example", expires_in=left)
    assert certificates.authority.secure(made.folder, ["a.example"]).is_new is is_new


def test_a_certificate_for_other_names_is_made_again(certificates: Certificates) -> None:
    made = certificates.make("a.example")
    assert certificates.authority.secure(made.folder, ["b.example"]).is_new


def test_a_crash_between_key_and_certificate_is_repaired(certificates: Certificates) -> None:
    made = certificates.make("a.example")
    other = certificates.make("a.example", server="other")
    made.key.write_bytes(other.key.read_bytes())
    assert certificates.authority.secure(made.folder, ["a.example"]).is_new


def test_clients_get_the_certificate_of_the_authority_alone(certificates: Certificates) -> None:
    certificates.authority.trust(certificates.folder / "clients")
    (file,) = (certificates.folder / "clients").iterdir()
    assert file.read_bytes() == certificates.authority.path.read_bytes()


def test_renew_makes_every_certificate_again_for_the_same_names(certificates: Certificates) -> None:
    made = [certificates.make("a.example", server="a"), certificates.make("b.example", server="b")]
    serials = [serial_in(one.certificate) for one in made]
    renewed = certificates.authority.renew()
    assert [one.names for one in renewed] == [one.names for one in made]
    assert not set(serials) & {serial_in(one.certificate) for one in renewed}


@pytest.mark.parametrize("wrong", ["https://cell", "cell:54400", "a b", "", "a..b", "ä.example", "a/b"])
def test_what_is_no_host_is_refused(wrong: str) -> None:
    with pytest.raises(UsageError, match="neither a host name nor an address"):
        checked_name(wrong)


def test_a_damaged_authority_is_never_replaced_silently(certificates: Certificates) -> None:
    certificates.make("a.example")
    (certificates.folder / "authority" / "authority.key").write_text("rubbish")
    with pytest.raises(UsageError, match=r"the authority in .* cannot be used"):
        _ = certificates.authority
