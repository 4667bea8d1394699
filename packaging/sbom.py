"""The software bill of materials: every wheel, and the libraries in it, as a CycloneDX document."""

import hashlib
import json
import re
import zipfile
from collections.abc import Iterator
from email import message_from_bytes
from pathlib import Path
from typing import Any

SPEC_VERSION = "1.6"
SHARED_LIBRARY = re.compile(r"\.so(\.|$)")
FFMPEG_VERSION = re.compile(rb"FFmpeg version (\d[\w.]*)")


def document(wheels: list[Path], project: str, version: str) -> str:
    """Of the same wheels the same text. `project` is the name of the one that the others are needed by."""
    components = [_component(wheel) for wheel in sorted(wheels)]
    own = {"type": "application", "name": project, "version": version, "bom-ref": f"pkg:pypi/{project}@{version}"}
    made = {
        "bomFormat": "CycloneDX",
        "specVersion": SPEC_VERSION,
        "version": 1,
        "metadata": {"component": own},
        "components": [one for one in components if one["name"] != project],
    }
    return json.dumps(made, indent=1, sort_keys=True) + "\n"


def _component(path: Path) -> dict[str, Any]:
    with zipfile.ZipFile(path) as wheel:
        names = wheel.namelist()
        (metadata,) = [name for name in names if re.fullmatch(r"[^/]+\.dist-info/METADATA", name)]
        about = message_from_bytes(wheel.read(metadata))
        name = re.sub(r"[-_.]+", "-", about["Name"]).lower()
        stated = [name for name in names if re.search(r"\.dist-info/sboms/[^/]+\.json$", name)]
        libraries = [name for name in names if SHARED_LIBRARY.search(name) and ".libs/" in name]
        inside = [*_ffmpeg(wheel, libraries), *(_library(wheel, name) for name in libraries)]
        for one in stated:  # what its own builder states, of statically linked parts, too
            inside += _stated(json.loads(wheel.read(one)), name)
    made = {
        "type": "library",
        "name": name,
        "version": about["Version"],
        "purl": f"pkg:pypi/{name}@{about['Version']}",
        "bom-ref": path.name,
        "hashes": [{"alg": "SHA-256", "content": hashlib.sha256(path.read_bytes()).hexdigest()}],
        "properties": [{"name": "wheel", "value": path.name}],
    }
    if expression := about["License-Expression"]:
        made["licenses"] = [{"expression": expression}]
    else:
        classified = [
            one.rpartition(" :: ")[2] for one in about.get_all("Classifier", []) if one.startswith("License ::")
        ]
        named = (about["License"] or "").strip().splitlines()[:1] or classified
        made["licenses"] = [{"license": {"name": text}} for text in named]
    return made | ({"components": inside} if inside else {})


def _ffmpeg(wheel: zipfile.ZipFile, libraries: list[str]) -> Iterator[dict[str, Any]]:
    """Its libraries have numbers of their own; faults are reported by the release."""
    for name in libraries:
        if "/libavutil" in name and (found := FFMPEG_VERSION.search(wheel.read(name))):
            version = found[1].decode()
            yield {
                "type": "library",
                "name": "ffmpeg",
                "version": version,
                "purl": f"pkg:generic/ffmpeg@{version}",
                "cpe": f"cpe:2.3:a:ffmpeg:ffmpeg:{version}:*:*:*:*:*:*:*",
                "licenses": [{"license": {"id": "LGPL-2.1-or-later"}}],
            }


def _library(wheel: zipfile.ZipFile, name: str) -> dict[str, Any]:
    digest = hashlib.sha256(wheel.read(name)).hexdigest()
    return {"type": "file", "name": name, "hashes": [{"alg": "SHA-256", "content": digest}]}


def _stated(sbom: dict[str, Any], name: str) -> Iterator[dict[str, Any]]:
    """References are left out: they are of another document."""
    seen = set()
    for one in sbom.get("components", []):
        kept = {key: one[key] for key in ("type", "name", "version", "purl", "licenses") if key in one}
        if one["name"].replace("_", "-") != name and (one["name"], one.get("version")) not in seen:
            seen.add((one["name"], one.get("version")))
            yield kept
