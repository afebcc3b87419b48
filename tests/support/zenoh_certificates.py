"""Certificates for the daemons of a fleet, and the access rules that go by their names."""

import json
import subprocess
from collections.abc import Iterable
from pathlib import Path

READ = ("state", "live", "topics", "out", "alive", "stop", "answer")
DRIVE = ("drive", "publish")
_MESSAGES = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
]


def make_authority(folder: Path) -> Path:
    """Create the certificate of an authority, with its key in the same folder."""
    certificate = folder / "ca.pem"
    _openssl(
        "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
        "-subj", "/CN=fleet", "-keyout", str(folder / "ca.key"), "-out", str(certificate),
    )  # fmt: skip
    return certificate


def make_certificate(folder: Path, name: str, address: str = "127.0.0.1", *, days: str = "2") -> tuple[Path, Path]:
    """Certificate and key of the daemon of this name, signed by the authority in the folder."""
    request, certificate, key = (folder / f"{name}.{kind}" for kind in ("csr", "pem", "key"))
    names = folder / f"{name}.ext"
    names.write_text(f"subjectAltName=DNS:{name},IP:{address}\n")
    _openssl(
        "req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes",
        "-subj", f"/CN={name}", "-keyout", str(key), "-out", str(request),
    )  # fmt: skip
    _openssl(
        "x509", "-req", "-in", str(request), "-CA", str(folder / "ca.pem"), "-CAkey", str(folder / "ca.key"),
        "-CAcreateserial", "-days", days, "-extfile", str(names), "-out", str(certificate),
    )  # fmt: skip
    return certificate, key


def write_rules(file: Path, *, drivers: Iterable[str], readers: Iterable[str]) -> Path:
    """Zenoh's configuration for a daemon: whose certificate may drive, and whose may only read and stop."""

    def rule(name: str, verbs: Iterable[str]) -> dict[str, object]:
        keys = [f"hostlink/{verb}/**" for verb in verbs]
        return {
            "id": name,
            "permission": "allow",
            "flows": ["ingress", "egress"],
            "messages": _MESSAGES,
            "key_exprs": keys,
        }

    rules = {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule("read", READ), rule("drive", DRIVE)],
        "subjects": [
            {"id": "drivers", "cert_common_names": list(drivers)},
            {"id": "readers", "cert_common_names": list(readers)},
        ],
        "policies": [
            {"rules": ["read", "drive"], "subjects": ["drivers"]},
            {"rules": ["read"], "subjects": ["readers"]},
        ],
    }
    file.write_text(json.dumps({"access_control": rules}))
    return file


def _openssl(*arguments: str) -> None:
    subprocess.run(["openssl", *arguments], check=True, capture_output=True)
