"""The file of the proposing net: there, and complete? Light: the main process checks it before anything starts."""

from hashlib import sha256
from pathlib import Path

from gateway.config import VisionConfig
from gateway.errors import ConfigError

PATH = Path(__file__).with_name("proposer.onnx")
SHA256 = "62577ea587ec858c4f2a2ecadd3173b27f50f15a9ad1561fd2eedf58ab51f6c9"
"""Of the shipped file; `training.proposer` prints it."""


def read(path: Path = PATH) -> bytes:
    """Its bytes. Raises ConfigError for a file that is missing, cannot be read, or is not the shipped one."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(unusable(path, f"cannot be read: {error.strerror}")) from error
    if sha256(data).hexdigest() != SHA256:
        raise ConfigError(unusable(path, "is damaged"))
    return data


def unusable(path: Path, why: str) -> str:
    """An error's text."""
    remedy = 'install the gateway again, or set vision.proposals = "classical"'
    return f"the net that proposes, {path}, {why}; {remedy}"


def check(params: VisionConfig) -> None:
    """Raises ConfigError where the settings need the net and it cannot be used."""
    if params.proposals != "classical":
        read()
