"""What the packages say of their parts."""

import json
import re
import sys
import zipfile
from importlib.metadata import files
from pathlib import Path
from typing import Any

import pytest

PACKAGING = Path(__file__).parents[2] / "packaging"

sys.path.insert(0, str(PACKAGING))
try:
    import sbom
finally:
    sys.path.remove(str(PACKAGING))

pytestmark = pytest.mark.one_interpreter


def wheel(folder: Path, name: str, version: str, parts: dict[str, bytes], head: str = "") -> Path:
    path = folder / f"{name}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as made:
        about = f"Metadata-Version: 2.4\nName: {name}\nVersion: {version}\n{head}"
        made.writestr(f"{name}-{version}.dist-info/METADATA", about)
        for part, content in parts.items():
            made.writestr(part, content)
    return path


def test_every_wheel_is_named_with_the_libraries_in_it(tmp_path: Path) -> None:
    stated = {
        "components": [
            {"type": "library", "name": "open_cv", "version": "5.0"},
            {"type": "library", "name": "openssl-libs", "version": "1.1.1k-15.el8_6", "bom-ref": "x", "purl": "pkg:x"},
            {"type": "library", "name": "openssl-libs", "version": "1.1.1k-15.el8_6", "bom-ref": "y", "purl": "pkg:x"},
        ]
    }
    parts = {
        "open_cv.libs/libavutil-1.so.60.26.101": b"\0abc FFmpeg version 8.1.1\0",
        "open_cv.libs/libssl-2.so.1.1.1k": b"ssl",
        "open_cv-5.0.dist-info/sboms/auditwheel.cdx.json": json.dumps(stated).encode(),
    }
    wheels = [
        wheel(tmp_path, "the_gateway", "1.2", {}),
        wheel(tmp_path, "open_cv", "5.0", parts, "License: Apache 2.0\n"),
        wheel(tmp_path, "lz4", "4.4", {}, "Classifier: License :: OSI Approved :: BSD License\n"),
        wheel(tmp_path, "anyio", "4.16", {"anyio/a.so": b"x"}, "License-Expression: MIT\n"),
    ]
    text = sbom.document(wheels, "the-gateway", "1.2")
    found: dict[str, Any] = json.loads(text)

    assert text == sbom.document(wheels[::-1], "the-gateway", "1.2")
    assert (found["bomFormat"], found["specVersion"]) == ("CycloneDX", "1.6")
    assert found["metadata"]["component"]["name"] == "the-gateway"
    anyio, lz4, opencv = found["components"]
    assert (anyio["purl"], anyio["licenses"]) == ("pkg:pypi/anyio@4.16", [{"expression": "MIT"}])
    assert lz4["licenses"] == [{"license": {"name": "BSD License"}}]
    assert (opencv["name"], opencv["version"]) == ("open-cv", "5.0")
    assert opencv["licenses"] == [{"license": {"name": "Apache 2.0"}}]
    assert len(opencv["hashes"][0]["content"]) == 64
    assert [(one["name"], one.get("version")) for one in opencv["components"]] == [
        ("ffmpeg", "8.1.1"),
        ("open_cv.libs/libavutil-1.so.60.26.101", None),
        ("open_cv.libs/libssl-2.so.1.1.1k", None),
        ("openssl-libs", "1.1.1k-15.el8_6"),
    ]
    assert opencv["components"][0]["licenses"] == [{"license": {"id": "LGPL-2.1-or-later"}}]
    assert opencv["components"][0]["cpe"] == "cpe:2.3:a:ffmpeg:ffmpeg:8.1.1:*:*:*:*:*:*:*"


def test_the_copyright_file_names_the_opc_ua_library_and_its_licence() -> None:
    text = (PACKAGING / "debian/copyright").read_text()
    (stanza,) = [one for one in text.split("\n\n") if "wheels/asyncua-*.whl" in one]
    assert "\nLicense: LGPL-3+\n" in stanza
    assert "/usr/share/common-licenses/LGPL-3." in text


def test_the_copyright_file_names_the_ffmpeg_that_opencv_brings_and_its_source() -> None:
    (library,) = [file for file in files("opencv-python-headless") or () if file.name.startswith("libavutil")]
    version = sbom.FFMPEG_VERSION.search(Path(str(library.locate())).read_bytes())
    assert version is not None
    text = re.sub(r"\s+", " ", (PACKAGING / "debian/copyright").read_text())
    assert f"FFmpeg {version[1].decode()} as shared libraries" in text
    assert f"https://ffmpeg.org/releases/ffmpeg-{version[1].decode()}.tar.xz" in text
    assert "/usr/share/common-licenses/LGPL-2.1" in text
