"""Compiles the TCK, its dependencies and java/: what the TCK's own build generates is generated here."""

import re
import subprocess
from collections.abc import Iterable
from pathlib import Path

JAVA = Path(__file__).parent / "java"
JAR_FOLDER = Path("/usr/share/java")
JARS = (
    "protobuf", "jackson-core", "jackson-databind", "jackson-annotations", "guava", "slf4j-api", "slf4j-simple",
    "org.jetbrains.annotations-common", "org.jetbrains.annotations-java8",
)  # fmt: skip
PACKAGES = (
    "default-jdk-headless libprotobuf-java libjackson2-core-java libjackson2-databind-java "
    "libjackson2-annotations-java libguava-java libslf4j-java libjetbrains-annotations-java"
)
REPOSITORIES = {  # folder: where it is on GitHub
    "sparkplug": "eclipse-sparkplug/sparkplug",
    "hivemq-extension-sdk": "hivemq/hivemq-extension-sdk",
    "paho.mqtt.java": "eclipse/paho.mqtt.java",
}
PACKAGE = Path("org/eclipse/sparkplug/tck")
EDITS = {  # in a copy of the TCK: what is there, and what takes its place
    PACKAGE / "test/Results.java": [('"tcp://localhost:1883"', 'System.getProperty("broker")')],
    PACKAGE / "utility/EdgeNode.java": [('"tcp://localhost:1883"', 'System.getProperty("broker")')],
    PACKAGE / "utility/HostApplication.java": [
        ('"tcp://localhost:1883"', 'System.getProperty("broker")'),
        # In Jackson 2.12 and later this exception is none that the compiler finds thrown in that block.
        ("catch (JsonProcessingException e)", "catch (Exception e)"),
    ],
}
TESTABLE = re.compile(r"\[tck-testable tck-id-([\w-]+)\]#(.*?)#", re.DOTALL)
MARK = re.compile(r"^\[yellow-background\]\*\[[\w-]+\]\s*|\*$")
CONSTANT = re.compile(r"\bSections\.([A-Z0-9_]+)")


class BuildError(Exception):
    """Something that the TCK needs is missing, or is not as expected."""


def statements(specification: str) -> dict[str, str]:
    """The testable statements of the specification's asciidoc: id (without `tck-id-`) -> text on one line."""
    return {name: MARK.sub("", " ".join(text.split())) for name, text in TESTABLE.findall(specification)}


def requirements(found: dict[str, str]) -> str:
    """The TCK's Requirements.java: two constants for each statement, its id and its text."""
    lines = ["package org.eclipse.sparkplug.tck.test.common;", "public class Requirements {"]
    for name, text in found.items():
        constant, quoted = name.upper().replace("-", "_"), text.replace("\\", "\\\\").replace('"', "'")
        lines.append(f'  public final static String ID_{constant} = "tck-id-{name}";')
        lines.append(f'  public final static String {constant} = "{quoted}";')
    return "\n".join([*lines, "}", ""])


def sections(sources: Iterable[str]) -> str:
    """The TCK's Sections.java: the constants that annotations in `sources` name. Nothing reads their values."""
    names = sorted({name for source in sources for name in CONSTANT.findall(source)})
    lines = [f'  public final static String {name} = "{name.lower()}";' for name in names]
    return "\n".join(["package org.eclipse.sparkplug.tck.sparkplug;", "public class Sections {", *lines, "}", ""])


def edited(path: Path, text: str) -> str:
    """A source file of the TCK with EDITS made; BuildError if it is another version's."""
    for old, new in EDITS.get(path, []):
        if old not in text:
            raise BuildError(f"{path}: {old} is not in this version of the TCK")
        text = text.replace(old, new)
    return text


def build(tck: Path, folder: Path) -> str:
    """Compile into `folder`; the class path. `tck`: the folder with the three REPOSITORIES."""
    for name, repository in REPOSITORIES.items():
        if not (tck / name).is_dir():
            raise BuildError(f"{tck / name} is missing: git clone https://github.com/{repository}")
    jars = [JAR_FOLDER / f"{name}.jar" for name in JARS]
    if missing := [jar.name for jar in jars if not jar.exists()]:
        raise BuildError(f"{', '.join(missing)} missing in {JAR_FOLDER}: apt-get install {PACKAGES}")
    source, classes = folder / "source", folder / "classes"
    _write_sources(tck, source)
    paho = tck / "paho.mqtt.java" / "org.eclipse.paho.client.mqttv3" / "src" / "main"
    sdk = tck / "hivemq-extension-sdk" / "src" / "main" / "java"
    roots = [source, sdk, paho / "java", paho / "java-templates", JAVA, JAVA / "stub"]
    classes.mkdir()
    command = ["javac", "-nowarn", "-proc:none", "-encoding", "UTF-8", "-d", str(classes)]
    command += ["-cp", _path(jars), "-sourcepath", _path(roots), str(JAVA / "Shim.java")]
    command += map(str, sorted((source / PACKAGE / "test/edge").glob("*.java")))  # found by name at run time
    # What paho finds by name at run time, too.
    command += map(str, sorted(paho.glob("java/org/eclipse/paho/client/mqttv3/**/*Factory.java")))
    command += map(str, sorted(paho.glob("java/org/eclipse/paho/client/mqttv3/logging/*.java")))
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise BuildError(f"javac: {done.stderr[-3000:]}")
    return _path([classes, paho / "resources", *jars])


def _write_sources(tck: Path, into: Path) -> None:
    """The TCK's sources with EDITS made, and the two that it generates."""
    root = tck / "sparkplug" / "tck" / "src" / "main" / "java"
    texts = {path.relative_to(root): path.read_text(encoding="utf-8") for path in root.rglob("*.java")}
    chapters = (tck / "sparkplug" / "specification" / "src" / "main" / "asciidoc" / "chapters").glob("*.adoc")
    specification = "\n".join(path.read_text(encoding="utf-8") for path in sorted(chapters))
    made = {path: edited(path, text) for path, text in texts.items()}
    if absent := EDITS.keys() - made.keys():
        raise BuildError(f"{root}: no {', '.join(map(str, sorted(absent)))}; is this the TCK?")
    made[PACKAGE / "test/common/Requirements.java"] = requirements(statements(specification))
    made[PACKAGE / "sparkplug/Sections.java"] = sections(texts.values())
    for path, text in made.items():
        (into / path).parent.mkdir(parents=True, exist_ok=True)
        (into / path).write_text(text, encoding="utf-8")


def _path(places: Iterable[Path]) -> str:
    return ":".join(map(str, places))
