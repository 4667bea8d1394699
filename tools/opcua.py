"""Generated tables of docs/opcua.md. Pure."""

from asyncua import ua

from gateway.core.readings import Quality
from gateway.opcua.data import STATUS


def status_codes() -> str:
    """Each code, with the qualities that it stands for."""
    rows = {code: ", ".join(q.name for q in Quality if STATUS.get(q) == code) for code in STATUS.values()}
    named = [f"{ua.status_codes.get_name_and_doc(code)[0]} {names}" for code, names in rows.items()]
    return "; ".join([*named, "BadNoDataAvailable without a quality"]) + "."


BLOCKS = {"status codes": status_codes}
