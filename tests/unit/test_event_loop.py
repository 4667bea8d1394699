"""The event loop that the gateway runs on."""

import gc

from gateway import event_loop


async def _frozen() -> int:
    return gc.get_freeze_count()


def test_what_was_loaded_before_is_not_looked_through_for_garbage_while_the_loop_runs() -> None:
    gc.unfreeze()
    try:
        assert gc.get_freeze_count() == 0
        assert event_loop.run(_frozen()) > 10_000
    finally:
        gc.unfreeze()
