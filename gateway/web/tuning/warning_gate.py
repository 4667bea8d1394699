"""Settings of vision go live, or into the file, only with warnings that were read and accepted: the one place that
refuses the others, whatever page they come from. asyncio."""

import logging
from collections.abc import Collection, Mapping
from dataclasses import asdict, replace

from gateway.config import VisionConfig
from gateway.core.plc import Writer
from gateway.web.auth.audit_log import printable
from gateway.web.auth.refusals import RefusalError
from gateway.web.tuning.standing_warnings import StandingWarning, covers, merged
from gateway.web.tuning.tuning_service import TuningService

log = logging.getLogger(__name__)

REFUSED = (
    "there are warnings that are not accepted: `warnings` of the answer has id, text, key and pictures of each; those "
    "of test sets have `bay` and `test_set`, and `scoring`: the score runs, and may be waited for"
)


async def check(
    service: TuningService, settings: Mapping[str, VisionConfig], accepted: Collection[str], what: str, who: Writer
) -> None:
    """`settings`: by bay; `what` becomes of them: go live, are saved; `accepted`: ids.

    Raises RefusalError with all standing warnings where one of them is not accepted, or has clearly other figures than
    the one that was accepted, and what `standing` raises. A warning that several bays have stands once, with the
    pictures of all.
    """
    of_bays: list[StandingWarning] = []
    for bay, vision in settings.items():
        for one in await service.standing(bay, vision):
            of_bays.append(replace(one, pictures=tuple(f"{bay}/{name}" for name in one.pictures)))
    found = merged(of_bays)
    if not found:
        return
    texts = "; ".join(map(str, found))
    if not all(any(covers(name, one.id) for name in accepted) for one in found):
        number = "1 warning" if len(found) == 1 else f"{len(found)} warnings"
        text = f"these settings {what} with {number} only if each is accepted: {texts}"
        raise RefusalError(409, "warnings", text, members={"warnings": [asdict(one) for one in found]})
    log.warning("%s: settings %s despite: %s; %s", ", ".join(settings), what, texts, printable(str(who)))
