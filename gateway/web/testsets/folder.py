"""Where a gateway's test sets are, and how their folders and files are named. Pure."""

import re
from pathlib import Path

from gateway import bay_file
from gateway.config import GatewayConfig
from gateway.vision.offline.evaluation import labels
from gateway.web.ipc.testsets import MAX_NAME

LABELS = labels.FILE_NAME
SET_NAME = re.compile(rf"\w(?:[\w -]{{0,{MAX_NAME - 2}}}\w)?")
PICTURE_NAME = re.compile(r"\w[\w .()+-]{0,119}\.(?:png|jpe?g)", re.IGNORECASE)


def folder_of(config: GatewayConfig) -> Path | None:
    """Of all bays; None: nothing is kept (`state_dir`)."""
    state = bay_file.folder_of(config)
    return None if state is None else state / "test-sets" / f"{config.site}.{config.instance}"


def is_part(path: Path) -> bool:
    """Is this the path of a set's picture, or of its labels, as far as its last two names say?"""
    named = path.name == LABELS or PICTURE_NAME.fullmatch(path.name) is not None
    return named and SET_NAME.fullmatch(path.parent.name) is not None
